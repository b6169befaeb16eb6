// Uses the client for npm in Node.js against a service; prints what a test checks.
import { createWriteStream } from "node:fs";
import { readdir } from "node:fs/promises";
import { pipeline } from "node:stream/promises";
import { Client, type Job, type JobSpec, type Progress, ServiceError, type Source } from "multicap-client";

const [url, key, folder] = process.argv.slice(2) as [string, string, string];
const client = Client.connect(url, { key });
const videos = (await readdir(folder)).filter((name) => name.endsWith(".mp4")).map((name) => `${folder}/${name}`);
const calibration = `${folder}/calibration.toml`;
const spec: JobSpec = { exports: ["bvh"], frame_range: [0, 20] };

async function refusal(task: Promise<unknown>) {
  try {
    await task;
  } catch (error) {
    if (!(error instanceof ServiceError)) throw error;
    const { code, status, message, errors, requestId } = error;
    return { code, status, message, requestId, errors: errors.map(({ code, file }) => ({ code, file })) };
  }
  throw new Error("It was not refused.");
}

const wrongKey = await refusal(Client.connect(url, { key: "mc_wrong" }).submit("Walk", videos, calibration, spec));

const noVideos: Source[] = ["left.mp4", "right.mp4"].map((name) => ({ name, content: new Blob(["no video"]) }));
const refused = await refusal(client.submit("Walk", noVideos, calibration, spec));
const badSpec = await refusal(client.submit("Walk", videos, calibration, { exports: ["mp3" as "bvh"], people: 0 } as JobSpec));

const whole = await client.submit("Whole", videos, calibration);
await client.cancel(whole);
const canceled = await refusal(client.follow(whole));

const progress: Progress[] = [];
const updates: Pick<Job, "state" | "progress">[] = [];
const job = await client.submit("Walk", videos, calibration, spec, { onProgress: (sent) => progress.push(sent) });
const last = await client.follow(job, ({ state, progress }) => updates.push({ state, progress }));
for (const { name } of await client.results(job)) {
  const { body } = await client.download(job, name);
  await pipeline(body!, createWriteStream(name));
}
const { data } = await client.api.GET("/v1/jobs", { params: { query: { limit: 1 } } });
console.log(JSON.stringify({ wrongKey, refused, badSpec, canceled, progress, updates, last, newest: data?.jobs[0]?.id }));
