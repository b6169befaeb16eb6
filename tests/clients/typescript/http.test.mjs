// Requests are sent again while the service is away, with one key; refusals are errors with all problems.

import assert from "node:assert/strict";
import { test } from "node:test";
import { answer, DIST, serve } from "./stub.mjs";

const { Client, ServiceError } = await import(`${DIST}/index.js`);
const { retryAfterMs } = await import(`${DIST}/http.js`);
const AT_ONCE = { "Retry-After": "0" };
const BODY = { name: "Hall" };

const rename = (client, options) => client.api.POST("/v1/sessions/{session_id}/jobs", { params: { path: { session_id: "7" } }, body: BODY, ...options });

test("post_during_outage_is_repeated_with_one_key", async (t) => {
  const service = await serve(t, (request, response, number) => {
    if (number === 1) return request.socket.destroy();
    if (number === 2) return answer(response, 503, { detail: "Away." }, AT_ONCE);
    return answer(response, 202, { id: "8" });
  });
  const { data } = await rename(Client.connect(service.url, { key: "mc_1" }));
  assert.deepEqual(data, { id: "8" });
  assert.equal(service.requests.length, 3);
  const [key, ...others] = service.requests.map(({ headers }) => headers["idempotency-key"]);
  assert.match(key, /^[0-9a-f]{32}$/);
  assert.deepEqual(others, [key, key]);
  for (const { body, headers, url } of service.requests) {
    assert.deepEqual([url, JSON.parse(body), headers.authorization], ["/v1/sessions/7/jobs", BODY, "Bearer mc_1"]);
  }
});

test("busy_key_is_awaited_without_limit", async (t) => {
  const service = await serve(t, (request, response, number) => {
    if (number <= 12) return answer(response, 409, { code: "idempotency_key_busy", detail: "Busy." }, AT_ONCE);
    return answer(response, 202, { id: "8" });
  });
  assert.equal((await rename(Client.connect(service.url))).data.id, "8");
  assert.equal(new Set(service.requests.map(({ headers }) => headers["idempotency-key"])).size, 1);
});

test("outage_of_all_tries_is_an_error", async (t) => {
  const service = await serve(t, (request, response) => {
    response.writeHead(502, AT_ONCE);
    response.end("<h1>Bad gateway</h1>");
  });
  await assert.rejects(rename(Client.connect(service.url)), { name: "ServiceError", status: 502, message: "The service answered 502." });
  assert.equal(service.requests.length, 8);
});

test("refusal_is_error_with_all_problems", async (t) => {
  const errors = [
    { code: "unreadable_video", message: "It is no video.", file: "a.mp4" },
    { code: "missing_field", message: "Give a name." },
  ];
  const problem = { detail: "2 things are wrong.", code: "invalid_request", hint: "Correct them.", errors, request_id: "r1", retryable: false };
  const service = await serve(t, (request, response) => answer(response, 422, problem));
  const error = await rename(Client.connect(service.url)).catch((refusal) => refusal);
  assert.ok(error instanceof ServiceError);
  assert.equal(error.message, "2 things are wrong. a.mp4: It is no video. Give a name. Correct them.");
  assert.deepEqual([error.code, error.hint, error.status, error.requestId, error.retryable], ["invalid_request", "Correct them.", 422, "r1", false]);
  assert.deepEqual(error.errors, errors);
  assert.equal(service.requests.length, 1);
});

test("conflict_without_retry_after_is_not_repeated", async (t) => {
  const service = await serve(t, (request, response) => answer(response, 409, { code: "not_finished", detail: "It runs.", retryable: true }));
  await assert.rejects(Client.connect(service.url).results({ id: "8" }), { code: "not_finished", retryable: true });
  assert.equal(service.requests.length, 1);
});

test("json_that_breaks_off_is_requested_again", async (t) => {
  const service = await serve(t, (request, response, number) => {
    if (number > 1) return answer(response, 200, { results: [{ name: "person-1.bvh" }] });
    response.writeHead(200, { "Content-Type": "application/json", "Content-Length": "100" });
    return response.write('{"results": [', () => request.socket.destroy());
  });
  assert.deepEqual(await Client.connect(service.url).results({ id: "8" }), [{ name: "person-1.bvh" }]);
});

test("signal_ends_a_pause", async (t) => {
  const service = await serve(t, (request, response) => answer(response, 503, { detail: "Away." }, { "Retry-After": "50" }));
  const signal = AbortSignal.timeout(300);
  await assert.rejects(rename(Client.connect(service.url), { signal }), { name: "TimeoutError" });
  assert.equal(service.requests.length, 1);
});

test("retry_after_of_no_number_is_none", () => {
  assert.deepEqual(["2", "0", "900", "Wed, 02 Dec 2026 02:08:02 GMT", "", null].map(retryAfterMs), [2000, 0, 60_000, null, null, null]);
});

test("address_without_http_is_refused", () => {
  for (const url of ["multicap.example", "ftp://multicap.example"]) assert.throws(() => Client.connect(url), TypeError);
});
