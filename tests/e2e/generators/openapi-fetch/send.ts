import { openAsBlob } from "node:fs";
import { readdir, writeFile } from "node:fs/promises";
import createClient from "openapi-fetch";
import type { paths } from "./multicap.d.ts";

const [url, key, folder] = process.argv.slice(2);
const client = createClient<paths>({ baseUrl: url, headers: { Authorization: `Bearer ${key}` } });

async function upload(name: string): Promise<string> {
  const body = await openAsBlob(`${folder}/${name}`);
  const { response } = await client.POST("/v1/uploads", {
    params: {
      header: {
        "tus-resumable": "1.0.0",
        "upload-length": String(body.size),
        "upload-metadata": `filename ${Buffer.from(name).toString("base64")}`,
      },
    },
  });
  const upload_id = response.headers.get("Location")!.split("/").at(-1)!;
  await client.PATCH("/v1/uploads/{upload_id}", {
    params: { path: { upload_id }, header: { "tus-resumable": "1.0.0", "upload-offset": "0" } },
    headers: { "Content-Type": "application/offset+octet-stream" },
    body,
    bodySerializer: (bytes) => bytes,
  });
  return upload_id;
}

const videos = (await readdir(folder!)).filter((name) => name.endsWith(".mp4"));
let { data: job } = await client.POST("/v1/jobs/from-uploads", {
  body: {
    videos: await Promise.all(videos.map(upload)),
    calibration: await upload("calibration.toml"),
    spec: { exports: ["bvh", "glb"], frame_range: [0, 20] },
  },
});
while (["queued", "running"].includes(job!.state)) {
  await new Promise((resume) => setTimeout(resume, 1000));
  ({ data: job } = await client.GET("/v1/jobs/{job_id}", { params: { path: { job_id: job!.id } } }));
}

const path = { job_id: job!.id };
const { data: listed } = await client.GET("/v1/jobs/{job_id}/results", { params: { path } });
for (const { name } of listed!.results) {
  const params = { path: { ...path, name } };
  const { data } = await client.GET("/v1/jobs/{job_id}/results/{name}", { params, parseAs: "blob" });
  await writeFile(name, data!.stream());
}
