// A job is followed by its event stream, continued after the last event, and by plain requests where no stream passes.

import assert from "node:assert/strict";
import { mock, test } from "node:test";
import { answer, DIST, serve } from "./stub.mjs";

const { Client } = await import(`${DIST}/index.js`);
const { JobEvents } = await import(`${DIST}/events.js`);
const job = (state, progress, more) => ({ id: "8", state, progress, error: null, ...more });
const event = (id, document) => `id: ${id}\r\nevent: job\r\ndata: ${JSON.stringify(document)}\r\nretry: 2000\r\n\r\n`;

function stream(response, ...texts) {
  response.writeHead(200, { "Content-Type": "text/event-stream" });
  for (const text of texts) response.write(text);
  response.end();
}

async function follow(url) {
  const seen = [];
  const last = await Client.connect(url).follow({ id: "8" }, ({ state, progress }) => seen.push(`${state} ${progress}`));
  assert.equal(`${last.state} ${last.progress}`, seen.at(-1));
  return seen;
}

test("broken_stream_continues_after_last_event", async (t) => {
  const streams = [];
  const service = await serve(t, ({ url, headers }, response) => {
    if (!url.endsWith("/events")) return answer(response, 200, job("running", 0.3));
    streams.push(headers["last-event-id"] ?? null);
    if (streams.length === 1) return stream(response, ": ping\n\n", event(4, job("queued", 0)), event(5, job("running", 0.2)), "id: 6\nevent: j");
    return stream(response, event(9, job("running", 0.9)), event(10, job("succeeded", 1)));
  });
  assert.deepEqual(await follow(service.url), ["queued 0", "running 0.2", "running 0.3", "running 0.9", "succeeded 1"]);
  assert.deepEqual(streams, [null, "5"]);
});

test("job_is_polled_where_streams_do_not_pass", async (t) => {
  let numPolls = 0;
  const service = await serve(t, ({ url }, response) => {
    if (url.endsWith("/events")) return answer(response, 429, { code: "too_many_streams", detail: "Too many." }, { "Retry-After": "10" });
    numPolls += 1;
    return answer(response, 200, numPolls === 5 ? job("succeeded", 1) : job("running", numPolls / 10));
  });
  assert.deepEqual(await follow(service.url), ["running 0.1", "running 0.2", "running 0.3", "running 0.4", "succeeded 1"]);
  assert.equal(service.requests.filter(({ url }) => url.endsWith("/events")).length, 3);
});

test("ended_job_whose_stream_is_empty_is_read", async (t) => {
  const service = await serve(t, ({ url }, response) => {
    if (!url.endsWith("/events")) return answer(response, 200, job("succeeded", 1));
    response.writeHead(204);
    return response.end();
  });
  assert.deepEqual(await follow(service.url), ["succeeded 1"]);
});

test("failed_job_is_error_with_its_problems", async (t) => {
  const errors = [{ code: "cameras_differ", message: "The clocks differ.", camera: "left", hint: null }];
  const error = { code: "session_refused", detail: "The check found an error.", hint: "Correct it.", retryable: false, errors };
  const service = await serve(t, (request, response) => stream(response, event(1, job("failed", 0.1, { error }))));
  const thrown = await follow(service.url).catch((problem) => problem);
  assert.equal(thrown.message, "The job failed. The check found an error. The clocks differ. Correct it.");
  assert.deepEqual([thrown.code, thrown.hint, thrown.errors], ["session_refused", "Correct it.", errors]);
});

test("canceled_job_is_error", async (t) => {
  const service = await serve(t, (request, response) => stream(response, event(1, job("canceled", 0.1))));
  await assert.rejects(follow(service.url), { code: "service_error", message: "The job was canceled." });
});

test("deleted_job_is_error", async (t) => {
  const service = await serve(t, ({ url }, response) => {
    if (url.endsWith("/events")) return stream(response, "event: gone\ndata: {}\n\n");
    return answer(response, 404, { code: "not_found", detail: "There is no such job." });
  });
  await assert.rejects(follow(service.url), { code: "not_found", status: 404 });
});

test("error_of_callback_is_thrown", async (t) => {
  const service = await serve(t, (request, response) => stream(response, event(1, job("running", 0.1))));
  const failing = () => { throw new RangeError("mine"); };
  await assert.rejects(Client.connect(service.url).follow({ id: "8" }, failing), RangeError);
});

test("signal_ends_following", async (t) => {
  const service = await serve(t, (request, response) => {
    response.writeHead(200, { "Content-Type": "text/event-stream" });
    response.write(event(1, job("running", 0.1)));
  });
  const stop = new AbortController();
  const follows = Client.connect(service.url).follow({ id: "8" }, () => stop.abort(), { signal: stop.signal });
  await assert.rejects(follows, { name: "AbortError" });
});

test("stream_that_is_kept_back_is_left", async () => {
  mock.timers.enable({ apis: ["setTimeout"] });
  const signals = [];
  const events = new JobEvents((headers, signal) => {
    signals.push(signal);
    return new Promise((resolve, reject) => { signal.addEventListener("abort", () => reject(signal.reason)); });
  });
  for (let number = 1; number <= 3; number += 1) {
    assert.ok(events.arePassed);
    const next = events.read().next();
    await Promise.resolve();
    mock.timers.tick(9_999);
    assert.ok(!signals.at(-1).aborted);
    mock.timers.tick(1);
    assert.deepEqual(await next, { done: true, value: undefined });
  }
  assert.ok(!events.arePassed);
  mock.timers.reset();
});
