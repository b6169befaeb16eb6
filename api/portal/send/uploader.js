// Resumable upload of a file by tus (tus-js-client).

import "../vendor/tus.min.js";
import { RequestProblem } from "../shared/api.js";

const { Upload } = window.tus;
const RETRY_DELAYS_MS = [0, 1000, 3000, 5000, 10_000, 20_000];

// Send a file, or go on with an upload whose address is known.
// Returns { stop }, which leaves what is stored; `done` resolves with the id, or rejects with a Problem.
export function upload(file, { name, url, onUrl, onProgress }) {
  let stop;
  const done = new Promise((resolve, reject) => {
    const task = new Upload(file, {
      endpoint: `${location.origin}/v1/uploads`,
      uploadUrl: url,
      metadata: { filename: name },
      retryDelays: RETRY_DELAYS_MS,
      storeFingerprintForResuming: false, // the draft remembers addresses
      onUploadUrlAvailable: () => onUrl(task.url),
      onProgress,
      onSuccess: () => resolve(task.url.slice(task.url.lastIndexOf("/") + 1)),
      onError: (error) => reject(problemOf(error)),
    });
    stop = () => {
      task.abort();
      resolve(null);
    };
    task.start();
  });
  return { stop, done };
}

function problemOf(error) {
  const answer = error.originalResponse;
  if (!answer) return new RequestProblem(null);
  try {
    return new RequestProblem(JSON.parse(answer.getBody()), answer.getStatus());
  } catch {
    return new RequestProblem(null, answer.getStatus());
  }
}

// Forget an upload that no session will use.
export function discard(url) {
  return fetch(url, { method: "DELETE", headers: { "Tus-Resumable": "1.0.0" } }).catch(() => null);
}
