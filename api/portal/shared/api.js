// Requests to the service, by the browser's session or by the link that the page was opened with.

import { PROBLEMS } from "./strings/common.js";

// Refusals until others of the caller's own requests are answered.
const BUSY = ["too_many_at_once", "too_many_checks"];

export class RequestProblem extends Error {
  // body: a problem of RFC 9457, or null if the service did not answer.
  constructor(body, status = 0) {
    super(body?.detail ?? PROBLEMS.away);
    this.code = body?.code ?? null;
    this.items = body?.errors ?? [];
    this.hint = body?.hint ?? null;
    this.status = status;
  }

  // True if the service, or what it needs, could not be reached or was busy: the same request may succeed later.
  get isAway() { return [0, 502, 503, 504].includes(this.status) || BUSY.includes(this.code); }
}

let link = null;

// From now on open everything by a link's secret.
export function useLink(secret) {
  link = secret;
}

// Address of something of the service for requests, videos and downloads: with the link's secret, if there is one.
export function addressed(path) {
  return link === null ? path : `${path}${path.includes("?") ? "&" : "?"}link=${encodeURIComponent(link)}`;
}

async function send(path, { method = "GET", body, form, headers: more, isFile = false } = {}) {
  const headers = { Accept: "application/json", ...more, ...(body !== undefined && { "Content-Type": "application/json" }) };
  let response;
  try {
    response = await fetch(addressed(path), { method, headers, body: form ?? (body && JSON.stringify(body)) });
  } catch {
    throw new RequestProblem(null);
  }
  if (response.ok && isFile) return { answer: await response.blob(), response };
  const answer = response.status === 204 ? null : await response.json().catch(() => null);
  if (response.ok) return { answer, response };
  if (response.status === 401) signedOut.dispatchEvent(new Event("signedout"));
  throw new RequestProblem(answer, response.status);
}

// Answer's JSON; null of an empty answer. `signedOut` hears of requests that need a key.
export async function call(path, options) {
  return (await send(path, options)).answer;
}

// A file of the service, with the name that it states.
export async function readFile(path) {
  const { answer, response } = await send(path, { isFile: true });
  return new File([answer], decodeURIComponent(response.headers.get("Content-Disposition").split("''")[1]), { type: answer.type });
}

// Record with its entity tag, for a change by `If-Match`.
export async function readTagged(path) {
  const { answer: record, response } = await send(path);
  return { record, etag: response.headers.get("ETag") };
}

export const signedOut = new EventTarget();

export const jsonPart = (value) => new Blob([JSON.stringify(value)], { type: "application/json" });

// Requests while the service can't be reached: they are made again when it answers.

const AGAIN_MS = 3000;

let answering = null; // promise of the next answer, which all waiting requests share

// Result of a task, which is tried again whenever the service was away. `away(problem)` hears of each failure, and
// `isOver()` tells that the result is not wanted any more; the last problem is then thrown.
export async function persistently(task, { away = () => {}, isOver = () => false } = {}) {
  for (;;) {
    try {
      return await task();
    } catch (problem) {
      if (!problem.isAway || isOver()) throw problem;
      away(problem);
      answering ??= nextAnswer().finally(() => { answering = null; });
      await answering;
      if (isOver()) throw problem;
    }
  }
}

async function nextAnswer() {
  do await pause(); while (!await reached());
}

export function reached() {
  return fetch("/healthz").then(({ ok }) => ok, () => false);
}

// A moment, cut short when the browser is connected again.
function pause() {
  return new Promise((resolve) => {
    const done = () => {
      clearTimeout(timer);
      removeEventListener("online", done);
      resolve();
    };
    const timer = setTimeout(done, AGAIN_MS);
    addEventListener("online", done);
  });
}
