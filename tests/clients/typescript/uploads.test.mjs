// Captures are sent by tus from paths, files and streams; broken uploads continue, and failed captures leave none.

import assert from "node:assert/strict";
import { mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { Readable } from "node:stream";
import { test } from "node:test";
import { answer, DIST, serve } from "./stub.mjs";

const { Client } = await import(`${DIST}/index.js`);
const bytes = (length, step) => Buffer.from(Array.from({ length }, (_, index) => (index * step) % 251));
const VIDEO = bytes(400_000, 3), OTHER = bytes(9_000_000, 5), THIRD = bytes(70_000, 11), CALIBRATION = bytes(50, 7);

// A tus server. `meddle(request, response)` is true if it answered a request itself.
async function tus(t, meddle = () => false) {
  const files = new Map();
  const made = [];
  const service = await serve(t, (request, response) => {
    const id = request.url.split("/").at(-1);
    const file = files.get(id);
    if (meddle(request, response, file)) return;
    if (request.method === "POST" && id === "uploads") {
      const name = Buffer.from(request.headers["upload-metadata"].split(" ")[1], "base64").toString();
      const next = `u${made.length}`;
      made.push(name);
      files.set(next, { name, size: Number(request.headers["upload-length"]), content: Buffer.alloc(0) });
      response.writeHead(201, { Location: `/v1/uploads/${next}` }).end();
    } else if (request.method === "PATCH") {
      assert.equal(Number(request.headers["upload-offset"]), file.content.length);
      file.content = Buffer.concat([file.content, request.body]);
      response.writeHead(204, { "Upload-Offset": file.content.length }).end();
    } else if (request.method === "HEAD") {
      response.writeHead(200, { "Upload-Offset": file.content.length, "Upload-Length": file.size }).end();
    } else if (request.method === "DELETE") {
      files.delete(id);
      response.writeHead(204).end();
    } else {
      answer(response, 202, { id: "8", state: "queued" });
    }
  });
  return { ...service, files };
}

async function requireNoUploads({ files }) {
  for (let number = 0; files.size > 0 && number < 50; number += 1) await new Promise((resolve) => { setTimeout(resolve, 100); });
  assert.equal(files.size, 0);
}

function folder(t) {
  const path = mkdtempSync(join(tmpdir(), "uploads-"));
  t.after(() => rmSync(path, { recursive: true }));
  writeFileSync(join(path, "left.mp4"), VIDEO);
  return path;
}

test("paths_streams_and_files_arrive_whole", async (t) => {
  const service = await tus(t);
  const reports = [];
  const stream = { name: "right.mp4", content: Readable.from(function* () { for (let at = 0; at < OTHER.length; at += 100_000) yield OTHER.subarray(at, at + 100_000); }()), size: OTHER.length };
  const web = { name: "top.mp4", content: new Blob([THIRD]).stream(), size: THIRD.length };
  const videos = [join(folder(t), "left.mp4"), stream, web];
  const calibration = new File([CALIBRATION], "Calib ü.toml");
  const options = { manifest: { frame_rate_hz: 25 }, onProgress: (progress) => reports.push(progress) };
  const job = await Client.connect(`${service.url}/`, { key: "mc_1" }).submit("Walk", videos, calibration, { exports: ["bvh"] }, options);
  assert.deepEqual(job, { id: "8", state: "queued" });
  const content = new Map([...service.files.values()].map((file) => [file.name, file.content]));
  const expected = { "left.mp4": VIDEO, "right.mp4": OTHER, "top.mp4": THIRD, "Calib ü.toml": CALIBRATION };
  assert.deepEqual([...content.keys()].sort(), Object.keys(expected).sort());
  for (const [name, value] of Object.entries(expected)) assert.ok(content.get(name).equals(value), name);
  const body = JSON.parse(service.requests.at(-1).body);
  assert.equal(service.requests.at(-1).url, "/v1/jobs/from-uploads");
  assert.deepEqual({ ...body, videos: body.videos.map((id) => service.files.get(id).name), calibration: service.files.get(body.calibration).name }, {
    videos: ["left.mp4", "right.mp4", "top.mp4"], calibration: "Calib ü.toml", manifest: { name: "Walk", frame_rate_hz: 25 }, spec: { exports: ["bvh"] },
  });
  const total = VIDEO.length + OTHER.length + THIRD.length + CALIBRATION.length;
  assert.deepEqual(reports.at(-1), { sent: total, total });
  assert.ok(service.requests.every(({ headers }) => headers.authorization === "Bearer mc_1"));
});

test("links_of_videos_are_fetched_by_the_service", async (t) => {
  const link = "https://store.example/right.mp4?signature=a%20b";
  const service = await tus(t);
  const job = await Client.connect(service.url).submit("Walk", [link, new File([VIDEO], "left.mp4")], new File([CALIBRATION], "a.toml"));
  assert.equal(job.id, "8");
  const { videos, calibration } = JSON.parse(service.requests.at(-1).body);
  const names = [videos[1], calibration].map((id) => service.files.get(id).name);
  assert.deepEqual([videos[0], ...names], [link, "left.mp4", "a.toml"]);
});

test("broken_upload_continues_from_its_offset", async (t) => {
  let numPatches = 0;
  const service = await tus(t, (request, response, file) => {
    if (request.method !== "PATCH") return false;
    numPatches += 1;
    if (numPatches === 1) {
      file.content = Buffer.from(request.body.subarray(0, 100_000)); // the rest is lost
      request.socket.destroy();
    } else if (numPatches === 2) {
      answer(response, 429, { detail: "Wait." }, { "Retry-After": "0" });
    }
    return numPatches < 3;
  });
  await Client.connect(service.url).submit("Walk", [], join(folder(t), "left.mp4"));
  assert.ok(service.files.get("u0").content.equals(VIDEO));
  assert.equal(service.requests.filter(({ method }) => method === "POST").length, 2);
});

test("refused_capture_leaves_no_uploads", async (t) => {
  const service = await tus(t, ({ url }, response) => {
    if (url !== "/v1/jobs/from-uploads") return false;
    answer(response, 422, { code: "session_invalid", detail: "It is no video." });
    return true;
  });
  const files = ["a.mp4", "b.mp4"].map((name) => new File([VIDEO], name));
  await assert.rejects(Client.connect(service.url).submit("Walk", files, files[0]), { code: "session_invalid" });
  await requireNoUploads(service);
});

test("refused_upload_is_error_and_ends_the_others", async (t) => {
  const service = await tus(t, (request, response) => {
    if (request.method !== "POST" || service.files.size === 0) return false;
    answer(response, 403, { code: "quota_exceeded", detail: "Too many uploads.", hint: "Delete some." });
    return true;
  });
  const files = ["a.mp4", "b.mp4", "c.mp4"].map((name) => new File([VIDEO], name));
  const error = await Client.connect(service.url).submit("Walk", files, files[0]).catch((refusal) => refusal);
  assert.deepEqual([error.code, error.hint, error.status], ["quota_exceeded", "Delete some.", 403]);
  assert.equal(service.requests.filter(({ url }) => url.endsWith("/from-uploads")).length, 0);
  await requireNoUploads(service);
});

test("signal_ends_uploads_and_deletes_them", async (t) => {
  const stop = new AbortController();
  const service = await tus(t, ({ method }) => {
    if (method === "PATCH") stop.abort();
    return method === "PATCH";
  });
  const file = new File([VIDEO], "a.mp4");
  await assert.rejects(Client.connect(service.url).submit("Walk", [file], file, {}, { signal: stop.signal }), { name: "AbortError" });
  await requireNoUploads(service);
});

test("missing_path_is_error_before_anything_is_sent", async (t) => {
  const service = await tus(t);
  await assert.rejects(Client.connect(service.url).submit("Walk", [], join(folder(t), "missing.mp4")), { code: "ENOENT" });
  const stream = { name: "a.mp4", content: Readable.from([VIDEO]) };
  await assert.rejects(Client.connect(service.url).submit("Walk", [stream], stream), { message: "State the size of the stream a.mp4." });
  assert.equal(service.requests.length, 0);
});
