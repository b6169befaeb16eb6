// Recordings that the browser keeps, through the worker that writes them.

import { PHONE } from "../../shared/strings/phone.js";

const FOLDER = "multicap-takes";

/** Recordings of this browser. */
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
      for (const { reject } of this.#waiting.values()) reject(new Error(event.message || PHONE.storageFailed));
      this.#waiting.clear();
    });
  }

  /** True if this browser can keep recordings; private windows of some can't. */
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
    const parts = (await this.#ask("list")).map(readPart).filter(Boolean);
    return parts.sort((one, other) => one.take - other.take || one.part - other.part);
  }

  /** Bytes of a part as a file, which is not read into memory. */
  async openFile(key) {
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

// Journals of recordings: a line of JSON a fact. Parts of takes are read from them, and the messages about the parts.

const UNKNOWN_STD_S = 0.1; // of a first frame of which nothing was written any more

/** Facts of a journal, in order. The last line may be torn, and is then left out. */
export function parseJournal(text) {
  const facts = [];
  for (const line of text.split("\n").filter(Boolean)) {
    try {
      facts.push(JSON.parse(line));
    } catch {
      break;
    }
  }
  return facts;
}

/**
 * Part of a take, from the facts of its journal and the bytes that are there; null of a journal without its beginning.
 *
 * Times are the service's, in seconds. A part that was not ended was cut, and is there up to `endS`, its last piece. `isAgain` is
 * true of a part whose upload takes the place of one that the service has no more.
 */
export function readPart({ key, facts, numBytes, isOpen }) {
  const find = (kind) => facts.findLast((fact) => fact.fact === kind);
  const begin = facts[0]?.fact === "begin" ? facts[0] : null;
  if (!begin) return null;
  const [first, piece, end] = ["first", "piece", "end"].map(find);
  // An upload that the service has no more counts for nothing.
  const gone = facts.findLastIndex(({ fact }) => fact === "gone");
  const since = facts.slice(gone + 1);
  const [upload, sent] = ["upload", "sent"].map((kind) => since.findLast(({ fact }) => fact === kind));
  const firstFrameS = first?.at_s ?? begin.at_s;
  const endS = (end ?? piece)?.until_s ?? firstFrameS;
  return {
    key, recording: begin.recording, take: begin.take, part: begin.part, mimeType: begin.mime_type, track: begin.track ?? null,
    numBytes, isOpen, isCut: !isOpen && !end, firstFrameS, stdS: first?.std_s ?? UNKNOWN_STD_S, endS, durationS: Math.max(0, endS - firstFrameS),
    numFrames: (end ?? piece)?.num_frames ?? 0, dropped: (end ?? piece)?.dropped ?? 0,
    uploadUrl: upload?.url ?? null, uploadId: sent?.upload_id ?? null, isAgain: gone >= 0,
  };
}

/**
 * Times of a take without pictures, `[{ from_s, to_s }]` by the key of the part before them.
 *
 * `parts` are a take's parts, in order; `stopS` is its stop, null while it is recorded.
 */
export function findLosses(parts, stopS) {
  return new Map(parts.map((part, place) => {
    const next = parts[place + 1];
    const toS = next ? next.firstFrameS : part.isCut ? stopS : null;
    const isLost = toS !== null && toS > part.endS && (next || part.isCut);
    return [part.key, isLost ? [{ from_s: part.endS, to_s: toS }] : []];
  }));
}

export function fileMessage(part, uploadId, lost) {
  return {
    type: "file", take: part.take, part: part.part, upload_id: uploadId, num_bytes: part.numBytes, first_frame_s: part.firstFrameS, std_s: part.stdS,
    duration_s: part.durationS, num_frames: part.numFrames, dropped_frames: part.dropped, lost, track: part.track, mime_type: part.mimeType,
  };
}

export function stoppedMessage(take, parts, losses) {
  const sum = (value) => parts.reduce((total, part) => total + value(part), 0);
  const lost = [...losses.values()].flat();
  return {
    type: "stopped", take, num_parts: Math.max(1, parts.length), num_bytes: sum(({ numBytes }) => numBytes), num_frames: sum(({ numFrames }) => numFrames),
    dropped_frames: sum(({ dropped }) => dropped), lost_s: lost.reduce((total, { from_s: from, to_s: to }) => total + to - from, 0), is_cut: parts.at(-1)?.isCut ?? true,
  };
}

/** Key of a part, which is the name of its folder. */
export const partKey = (recording, take, part) => `${recording}.${String(take).padStart(4, "0")}.${part}`;
