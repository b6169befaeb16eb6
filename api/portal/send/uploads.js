// Uploads of a capture's files, a few at a time.

import "../vendor/tus.min.js";
import { RequestProblem } from "../shared/api.js";
import { SEND } from "../shared/strings/send.js";

const PARALLEL = 2;

export class UploadQueue {
  #tasks = new Map(); // running uploads by row
  #isCut = false;

  // `changed` is called whenever a row changes.
  constructor(changed) {
    this.changed = changed;
  }

  // Send the files of all rows that `rows()` gives, also of those that are added meanwhile. False if the uploads were stopped.
  async send(rows) {
    this.#isCut = false;
    const next = () => (this.#isCut ? undefined : rows().find((row) => row.file && !row.isSent && !row.isActive));
    const lane = async () => {
      for (let row = next(); row; row = next()) await this.#sendRow(row);
    };
    try {
      await Promise.all(Array.from({ length: PARALLEL }, lane));
    } catch (problem) {
      this.stop();
      throw problem;
    }
    return !this.#isCut;
  }

  // Leave the uploads as they are; what is stored of them stays.
  stop() {
    this.#isCut = true;
    for (const task of this.#tasks.values()) task.stop();
  }

  // Forget what is stored of a file, for example because it has another name now.
  forget(row) {
    this.#tasks.get(row)?.stop();
    this.#tasks.delete(row);
    if (row.url) discard(row.url);
    Object.assign(row, { url: null, sent: 0, isSent: false });
  }

  async #sendRow(row) {
    Object.assign(row, { isActive: true, hasFailed: false });
    // An upload that was forgotten may still answer.
    const update = (facts) => {
      if (this.#tasks.get(row) !== task) return;
      Object.assign(row, facts);
      this.changed();
    };
    const task = upload(row.file, {
      // The service finds the camera of a zip of keypoints by the name of the zip.
      name: row.kind === "keypoints" ? `${row.camera}.zip` : row.name,
      url: row.url,
      onUrl: (url) => update({ url }),
      onProgress: (sent) => update({ sent }),
    });
    this.#tasks.set(row, task);
    this.changed();
    try {
      if (await task.done !== null) update({ isSent: true, sent: row.size });
    } catch ({ message, hint, code, status }) {
      row.hasFailed = true;
      throw new RequestProblem({ detail: SEND.namedProblem(row.name, message), hint, code }, status);
    } finally {
      row.isActive = false;
      if (this.#tasks.get(row) === task) this.#tasks.delete(row);
      this.changed();
    }
  }
}

// Resumable upload of a file by tus (tus-js-client).

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
      onError: (error) => reject(uploadProblem(error)),
    });
    stop = () => {
      task.abort();
      resolve(null);
    };
    task.start();
  });
  return { stop, done };
}

function uploadProblem(error) {
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
