/** Requests that are sent again while the service does not answer, or asks to wait. */

import { ServiceError } from "./errors.js";

// Tries of a request that the service does not answer, and the pauses between them: about a minute.
const MAX_TRIES = 8;
const FIRST_PAUSE_MS = 1000;
const LONGEST_PAUSE_MS = 20_000;
const LONGEST_WAIT_MS = 60_000;
const AWAY = [502, 503, 504];

/** Wait; reject with the signal's reason if it aborts. */
export async function pause(ms: number, signal?: AbortSignal): Promise<void> {
  signal?.throwIfAborted();
  await new Promise<void>((resolve, reject) => {
    const stop = () => {
      clearTimeout(timer);
      reject(signal?.reason);
    };
    const timer = setTimeout(() => {
      signal?.removeEventListener("abort", stop);
      resolve();
    }, ms);
    signal?.addEventListener("abort", stop, { once: true });
  });
}

/** Milliseconds of a header `Retry-After`; `null` without it. */
export function retryAfterMs(header: string | null | undefined): number | null {
  return header && Number(header) >= 0 ? Math.min(LONGEST_WAIT_MS, 1000 * Number(header)) : null;
}

/**
 * Send a request; send it again for about a minute while the service does not answer or asks to wait.
 *
 * A POST gets an idempotency key, so that the service executes it once. While it is still executed, the service
 * answers 409 with `Retry-After`, for as long as the check of large files takes.
 */
export async function sendPatiently(request: Request, answerTo: (request: Request) => Promise<Response> = fetch): Promise<Response> {
  if (request.method === "POST" && !request.headers.has("Idempotency-Key")) {
    // `crypto.randomUUID` needs a secure page.
    const bytes = crypto.getRandomValues(new Uint8Array(16));
    request.headers.set("Idempotency-Key", Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join(""));
  }
  for (let numTries = 1; ; ) {
    const response = await answerTo(request.clone()).catch(() => null);
    request.signal.throwIfAborted();
    const wait = retryAfterMs(response?.headers.get("Retry-After"));
    if (response && !AWAY.includes(response.status) && (response.ok || wait === null)) return response;
    if (numTries === MAX_TRIES) {
      if (response) return response;
      throw new ServiceError({ detail: `The service at ${new URL(request.url).origin} does not answer.`, retryable: true });
    }
    await response?.body?.cancel();
    // Half of a pause is random, so that clients do not all return at one moment.
    const longest = Math.min(LONGEST_PAUSE_MS, FIRST_PAUSE_MS * 2 ** (numTries - 1));
    await pause(wait ?? longest * (0.5 + Math.random() / 2), request.signal);
    if (response?.status !== 409) numTries += 1;
  }
}

/** Send a request patiently; JSON that breaks off is requested again too. */
export function sendWhole(request: Request): Promise<Response> {
  return sendPatiently(request, async (attempt) => {
    const response = await fetch(attempt);
    const isJson = /^application\/(problem\+)?json/.test(response.headers.get("Content-Type") ?? "");
    return isJson ? new Response(await response.text(), { status: response.status, headers: response.headers }) : response;
  });
}
