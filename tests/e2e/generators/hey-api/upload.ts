import { openAsBlob } from "node:fs";
import { readdir } from "node:fs/promises";
import { client } from "./multicap/client.gen.ts";
import { continueUpload, createSessionAndJobFromUploads, createUpload } from "./multicap/index.ts";

const [url, key, folder] = process.argv.slice(2);
client.setConfig({ baseUrl: url, auth: ({ scheme }) => (scheme === "bearer" ? key : undefined) });
const throwOnError = true;

async function upload(name: string): Promise<string> {
  const body = await openAsBlob(`${folder}/${name}`);
  const begun = await createUpload({
    headers: {
      "tus-resumable": "1.0.0",
      "upload-length": String(body.size),
      "upload-metadata": `filename ${Buffer.from(name).toString("base64")}`,
    },
    throwOnError,
  });
  const upload_id = begun.response.headers.get("Location")!.split("/").at(-1)!;
  const headers = { "tus-resumable": "1.0.0", "upload-offset": "0" };
  await continueUpload({ path: { upload_id }, headers, body, throwOnError });
  return upload_id;
}

const videos = (await readdir(folder!)).filter((name) => name.endsWith(".mp4"));
const { data: job } = await createSessionAndJobFromUploads({
  body: {
    videos: await Promise.all(videos.map(upload)),
    calibration: await upload("calibration.toml"),
    spec: { exports: ["bvh", "glb"], frame_range: [0, 20] },
  },
  throwOnError,
});
console.log(job.id);
