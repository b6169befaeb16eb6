import { openAsBlob } from "node:fs";
import { readdir, writeFile } from "node:fs/promises";
import { client } from "./multicap/client.gen.ts";
import { createSessionAndJobFromFiles, getJob, getResult, listResults } from "./multicap/index.ts";

const [url, key, folder] = process.argv.slice(2);
client.setConfig({ baseUrl: url, auth: ({ scheme }) => (scheme === "bearer" ? key : undefined) });
const throwOnError = true;

const file = async (name: string) => new File([await openAsBlob(`${folder}/${name}`)], name);
const videos = (await readdir(folder!)).filter((name) => name.endsWith(".mp4"));

const sent = await createSessionAndJobFromFiles({
  body: {
    videos: await Promise.all(videos.map(file)),
    calibration: await file("calibration.toml"),
    manifest: { name: "Walk" },
    spec: { exports: ["bvh", "glb"], frame_range: [0, 20] },
  },
  throwOnError,
});
let job = sent.data;
while (["queued", "running"].includes(job.state)) {
  await new Promise((resume) => setTimeout(resume, 1000));
  job = (await getJob({ path: { job_id: job.id }, throwOnError })).data;
}

const listed = await listResults({ path: { job_id: job.id }, throwOnError });
for (const { name } of listed.data.results) {
  const { data } = await getResult({ path: { job_id: job.id, name }, parseAs: "blob", throwOnError });
  await writeFile(name, data.stream());
}
