/** Downloads that continue where the connection broke. */

import { ServiceError } from "./errors.js";
import { pause } from "./http.js";

const MAX_TRIES = 8;
const PAUSE_MS = 1000;

/** Response whose body continues after a break; `request` requests the file with some headers. */
export async function resumed(request: (headers: Record<string, string>) => Promise<Response>, signal?: AbortSignal): Promise<Response> {
  const first = await request({});
  const pieces = bytes(first, request, signal);
  const body = new ReadableStream<Uint8Array>({
    async pull(controller) {
      const { done, value } = await pieces.next();
      if (done) controller.close();
      else controller.enqueue(value);
    },
    async cancel() {
      await pieces.return();
    },
  });
  return new Response(body, { status: first.status, headers: first.headers });
}

async function* bytes(first: Response, request: (headers: Record<string, string>) => Promise<Response>, signal?: AbortSignal): AsyncGenerator<Uint8Array, void, void> {
  const etag = first.headers.get("ETag") ?? "";
  let position = 0;
  let response = first;
  for (let numTries = 1; ; numTries += 1) {
    // The whole file comes again where a server knows no ranges.
    let numKnown = response.status === 206 ? 0 : position;
    const reader = response.body?.getReader();
    try {
      for (let piece = await reader?.read(); piece && !piece.done; piece = await reader?.read()) {
        const news = piece.value.subarray(numKnown);
        numKnown -= piece.value.length - news.length;
        position += news.length;
        if (news.length > 0) yield news;
      }
      return;
    } catch {
      signal?.throwIfAborted();
      if (String(position) === first.headers.get("Content-Length")) return;
      if (numTries === MAX_TRIES) throw new ServiceError({ detail: "The download broke off. Try again.", retryable: true });
    } finally {
      await reader?.cancel().catch(() => {});
    }
    await pause(PAUSE_MS, signal);
    response = await request({ Range: `bytes=${position}-`, "If-Range": etag });
    if (response.headers.get("ETag") !== etag) throw new ServiceError({ detail: "The file changed during its download.", retryable: true });
  }
}
