// Frames of a take, fetched in pieces when they are needed. The pieces used last are kept, up to a limit of memory.

import { FrameRecords, parsePieces } from "./records.js";

const PIECE_BYTES = 2 ** 20;
const MIN_FRAMES = 64;
const MAX_FRAMES = 2048;
const KEPT_BYTES = 64 * 2 ** 20;
const RETRY_MS = 2000;

/** Events: `load` when frames have come, `problem` when they could not be fetched. */
export class MotionStore extends EventTarget {
  #source;
  #pieces = new Map(); // number of a piece: { buffer, byPerson }, the piece used last at the end
  #pending = new Map();
  #failedAt = -Infinity;
  #numBytes = 0;
  #closed = new AbortController();

  constructor(description, source) {
    super();
    this.#source = source;
    this.description = description;
    this.records = new FrameRecords(description);
    const frameBytes = this.records.numBytes * Math.max(1, description.people.length);
    this.pieceFrames = Math.min(MAX_FRAMES, Math.max(MIN_FRAMES, Math.floor(PIECE_BYTES / frameBytes)));
    this.problem = null;
  }

  /** Memory that the kept pieces take. */
  get numBytes() {
    return this.#numBytes;
  }

  /** Fetch what playing from a frame needs: its piece, and the following one. */
  want(frame) {
    const number = Math.floor(frame / this.pieceFrames);
    this.#fetch(number);
    if ((number + 1) * this.pieceFrames < this.description.num_frames) this.#fetch(number + 1);
  }

  /** Fetch a frame; returns a promise that is kept when it is here, or could not be fetched. */
  async loaded(frame) {
    const wanted = Math.min(this.description.num_frames - 1, Math.max(0, frame));
    this.want(wanted);
    while (!this.has(wanted) && this.problem === null && !this.#closed.signal.aborted) {
      await new Promise((resolve) => {
        for (const type of ["load", "problem"]) this.addEventListener(type, resolve, { once: true });
        this.#closed.signal.addEventListener("abort", resolve, { once: true });
      });
    }
  }

  /** Whether the frame is here, with all people in it. */
  has(frame) {
    return this.#pieces.has(Math.floor(frame / this.pieceFrames));
  }

  /** Place of a person's record of a frame; null if the person or the frame is not here. */
  place(person, frame) {
    const number = Math.floor(frame / this.pieceFrames);
    const piece = this.#pieces.get(number);
    const part = piece?.byPerson.get(this.description.people[person].id);
    if (!part || frame < part.firstFrame || frame >= part.firstFrame + part.numFrames) return null;
    return { buffer: piece.buffer, start: part.start + (frame - part.firstFrame) * this.records.numBytes };
  }

  /** Positions of a person's joints in a frame, as `Records.positions` writes them; whether there are any. */
  positions(person, frame, field, out) {
    const place = this.place(person, frame);
    if (place === null) return false;
    this.records.positions(place, field, this.description.people[person].position_step_m, out);
    return true;
  }

  /** Person, by id, and frame in whose files a person's frame is. */
  filed(person, frame) {
    return { id: this.description.people[person].id, frame };
  }

  close() {
    this.#closed.abort();
    this.#pieces.clear();
  }

  async #fetch(number) {
    const kept = this.#pieces.get(number);
    if (kept) { // used last
      this.#pieces.delete(number);
      this.#pieces.set(number, kept);
      return;
    }
    if (this.#pending.has(number) || performance.now() - this.#failedAt < RETRY_MS) return;
    const from = number * this.pieceFrames;
    const to = Math.min(from + this.pieceFrames, this.description.num_frames);
    this.#pending.set(number, true);
    try {
      const buffer = await this.#source.frames(from, to, this.#closed.signal);
      const byPerson = new Map(parsePieces(buffer).map((part) => [part.id, part]));
      this.#keep(number, { buffer, byPerson });
      this.problem = null;
      this.dispatchEvent(new Event("load"));
    } catch (error) {
      if (this.#closed.signal.aborted) return;
      this.#failedAt = performance.now();
      this.problem = error;
      this.dispatchEvent(new Event("problem"));
    } finally {
      this.#pending.delete(number);
    }
  }

  #keep(number, piece) {
    this.#pieces.set(number, piece);
    this.#numBytes += piece.buffer.byteLength;
    for (const [oldest, { buffer }] of this.#pieces) {
      if (this.#numBytes <= KEPT_BYTES || oldest === number) break;
      this.#pieces.delete(oldest);
      this.#numBytes -= buffer.byteLength;
    }
  }
}
