// Uploads of the parts that this phone recorded, one after the other, by tus. They go on after the page was closed.

import { PHONE } from "../../shared/strings/phone.js";
import "../../vendor/tus.min.js";
import { fileEnding } from "./take_recorder.js";

const { Upload } = window.tus;
const RETRY_DELAYS_MS = [0, 1000, 2000, 5000, 5000, 10_000];
const AGAIN_MS = 5000;
// A piece of an upload, so that a connection that fails in the middle has not to be noticed by the last byte.
const CHUNK_BYTES = 8 * 2 ** 20;

/** Sentence about an upload that failed: the service's own, if it answered. */
export function failureReason(error) {
  try {
    return JSON.parse(error.originalResponse.getBody()).detail ?? PHONE.serviceRefused;
  } catch {
    return error.originalResponse ? PHONE.serviceRefused : PHONE.serviceAway;
  }
}

/** Queue of uploads. `headers()` authorizes them, `changed()` hears of progress, `sent(part, uploadId)` of each that is complete. */
export class ClipSender {
  #journal;
  #queue = [];
  #running = null;
  progress = null; // `{ take, part, sent_bytes, num_bytes }` of the running upload
  problem = null; // `{ message }` of the last attempt if it came to nothing

  constructor({ journal, headers, changed, sent }) {
    this.#journal = journal;
    Object.assign(this, { headers, changed, sent });
    addEventListener("online", () => this.#retry?.());
  }

  /** Send a part, unless it waits already. */
  add(part) {
    if (this.#running?.key === part.key || this.#queue.some(({ key }) => key === part.key)) return;
    this.#queue.push(part);
    this.#next();
  }

  /** Leave a part out, for example because its take was discarded. */
  drop(key) {
    this.#queue = this.#queue.filter((part) => part.key !== key);
    if (this.#running?.key === key) this.#running.stop();
  }

  /** Return whether the service still has the upload of a part that was sent: after some time it is removed unless it was claimed. */
  async isKept({ uploadId }) {
    const answer = await fetch(`/v1/uploads/${uploadId}`, { method: "HEAD", headers: { ...this.headers(), "Tus-Resumable": "1.0.0" } }).catch(() => null);
    return answer?.status !== 404;
  }

  get keys() {
    return [...(this.#running ? [this.#running.key] : []), ...this.#queue.map(({ key }) => key)];
  }

  #retry = null;

  async #next() {
    if (this.#running || this.#queue.length === 0) return;
    const part = this.#queue.shift();
    this.#running = { key: part.key, stop: () => {} };
    try {
      const id = await this.#send(part);
      this.problem = null;
      if (id !== null) {
        await this.#journal.note(part.key, "sent", { upload_id: id });
        this.sent(part, id);
      }
    } catch (error) {
      this.problem = { message: failureReason(error) };
      this.#queue.unshift(part);
      this.changed();
      await new Promise((resolve) => { this.#retry = resolve; setTimeout(resolve, AGAIN_MS); });
    }
    this.#running = this.progress = null;
    this.changed();
    this.#next();
  }

  async #send(part) {
    const file = await this.#journal.openFile(part.key);
    let url = part.uploadUrl;
    return new Promise((resolve, reject) => {
      const task = new Upload(file, {
        endpoint: `${location.origin}/v1/uploads`,
        uploadUrl: url,
        headers: this.headers(),
        metadata: { filename: `take-${part.take}-${part.part}.${fileEnding(part.mimeType)}` },
        chunkSize: CHUNK_BYTES,
        retryDelays: RETRY_DELAYS_MS,
        storeFingerprintForResuming: false, // the journal remembers addresses
        onUploadUrlAvailable: () => {
          if (task.url === url) return;
          url = part.uploadUrl = task.url;
          this.#journal.note(part.key, "upload", { url });
        },
        onProgress: (sentBytes) => {
          this.progress = { take: part.take, part: part.part, sent_bytes: sentBytes, num_bytes: file.size };
          this.changed();
        },
        onSuccess: () => resolve(task.url.slice(task.url.lastIndexOf("/") + 1)),
        onError: reject,
      });
      Object.assign(this.#running, { stop: () => { task.abort(); resolve(null); } });
      task.start();
    });
  }
}
