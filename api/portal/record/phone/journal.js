// Recordings that the browser keeps, through the worker that writes them.

import { partOf } from "./journal_lines.js";

const FOLDER = "multicap-takes";

/** What this browser has recorded. */
export class TakeJournal {
  #worker = new Worker(new URL("./journal_worker.js", import.meta.url), { type: "module" });
  #waiting = new Map();
  #last = 0;

  constructor() {
    this.#worker.addEventListener("message", ({ data: { id, answer, error } }) => {
      const { resolve, reject } = this.#waiting.get(id);
      this.#waiting.delete(id);
      if (error === undefined) resolve(answer);
      else reject(new Error(error));
    });
    this.#worker.addEventListener("error", (event) => {
      for (const { reject } of this.#waiting.values()) reject(new Error(event.message || "The browser can't keep recordings."));
      this.#waiting.clear();
    });
  }

  /** Whether this browser can keep recordings; private windows of some can't. */
  static async isOffered() {
    try {
      await navigator.storage.getDirectory();
      return true;
    } catch {
      return false;
    }
  }

  begin(key, fact) {
    return this.#ask("begin", { key, fact: { fact: "begin", ...fact } });
  }

  async append(key, blob, fact) {
    const bytes = await blob.arrayBuffer();
    return this.#ask("append", { key, bytes, fact: { fact: "piece", ...fact } }, [bytes]);
  }

  note(key, kind, fact = {}) {
    return this.#ask("note", { key, fact: { fact: kind, ...fact } });
  }

  end(key, fact) {
    return this.#ask("end", { key, fact: { fact: "end", ...fact } });
  }

  remove(key) {
    return this.#ask("remove", { key });
  }

  /** Parts that this browser keeps, in order. */
  async parts() {
    const parts = (await this.#ask("list")).map(partOf).filter(Boolean);
    return parts.sort((one, other) => one.take - other.take || one.part - other.part);
  }

  /** Bytes of a part as a file, which is not read into memory. */
  async fileOf(key) {
    const root = await navigator.storage.getDirectory();
    const folder = await (await root.getDirectoryHandle(FOLDER)).getDirectoryHandle(key);
    return (await folder.getFileHandle("video")).getFile();
  }

  #ask(action, rest, transferred = []) {
    const id = ++this.#last;
    return new Promise((resolve, reject) => {
      this.#waiting.set(id, { resolve, reject });
      this.#worker.postMessage({ id, action, ...rest }, transferred);
    });
  }
}
