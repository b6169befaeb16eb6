// Downloads continue where the connection broke, with and without ranges, and never mix two files.

import assert from "node:assert/strict";
import { test } from "node:test";
import { DIST, serve } from "./stub.mjs";

const { Client } = await import(`${DIST}/index.js`);
const CONTENT = Buffer.from(Array.from({ length: 300_000 }, (_, index) => (index * 7 + (index >> 8)) % 256));
const HALF = 150_000;

// Sends the half of the file, then breaks.
function sendHalf(request, response, etag = '"a"') {
  response.writeHead(200, { "Content-Length": CONTENT.length, "Content-Type": "text/plain", ETag: etag });
  response.write(CONTENT.subarray(0, HALF), () => setTimeout(() => request.socket.destroy(), 100));
}

async function download(url) {
  const response = await Client.connect(url).download({ id: "8" }, "person 1.bvh");
  return { response, content: Buffer.from(await response.arrayBuffer()) };
}

test("broken_download_continues_by_range", async (t) => {
  const service = await serve(t, (request, response, number) => {
    if (number === 1) return sendHalf(request, response);
    const start = Number(/^bytes=(\d+)-$/.exec(request.headers.range)[1]);
    response.writeHead(206, { ETag: '"a"', "Content-Range": `bytes ${start}-${CONTENT.length - 1}/${CONTENT.length}` });
    return response.end(CONTENT.subarray(start));
  });
  const { response, content } = await download(service.url);
  assert.ok(content.equals(CONTENT));
  assert.equal(response.headers.get("Content-Type"), "text/plain");
  const [first, second] = service.requests;
  assert.equal(first.url, "/v1/jobs/8/results/person%201.bvh?redirect=true");
  assert.deepEqual([first.headers.range, second.headers["if-range"], service.requests.length], [undefined, '"a"', 2]);
});

test("whole_file_after_break_is_not_doubled", async (t) => {
  const service = await serve(t, (request, response, number) => {
    if (number < 3) return sendHalf(request, response);
    response.writeHead(200, { ETag: '"a"' });
    return response.end(CONTENT);
  });
  assert.ok((await download(service.url)).content.equals(CONTENT));
});

test("file_that_changes_meanwhile_is_error", async (t) => {
  const service = await serve(t, (request, response, number) => sendHalf(request, response, `"${number}"`));
  await assert.rejects(download(service.url), { name: "ServiceError", message: "The file changed during its download." });
});

test("reader_that_stops_ends_the_request", async (t) => {
  let closed;
  const ended = new Promise((resolve) => { closed = resolve; });
  const service = await serve(t, (request, response) => {
    response.on("close", closed);
    response.writeHead(200, { ETag: '"a"' });
    response.write(CONTENT);
  });
  const reader = (await Client.connect(service.url).download({ id: "8" }, "a.bvh")).body.getReader();
  assert.ok((await reader.read()).value.length > 0);
  await reader.cancel();
  await ended;
  assert.equal(service.requests.length, 1);
});
