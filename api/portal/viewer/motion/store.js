// Frames of a take: fetched from the service, embedded in a report, or put together by edits that have no files yet.

import { between } from "./kinematics.js";
import { about, FrameRecords, integers, chooseOrigin, parsePieces } from "./records.js";
import { decodeStrips, UNKNOWN_ERROR } from "./strips.js";

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

  /** True if the frame is here, with all people in it. */
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

// Frames of a take that are in the page itself, as in a report.

/** Store of a report's data (pipeline/export/report); it has the methods of `MotionStore` that views and time line need. */
export class EmbeddedStore extends EventTarget {
  #buffer;
  #stride; // number of frames from a record of a person to the next one; positions in between are interpolated
  #rows; // of each person: number of records, the first one's number among strides, and its place in the buffer
  #next;

  constructor({ frames, stride, ...description }) {
    super();
    this.description = about(description, chooseOrigin(description));
    this.records = new FrameRecords(this.description);
    this.#buffer = integers(frames, Uint8Array).buffer;
    this.#stride = stride;
    let start = 0;
    this.#rows = description.people.map(({ start_frame: from, num_frames: numFrames }) => {
      const first = Math.ceil(from / stride);
      const rows = { first, count: Math.ceil((from + numFrames) / stride) - first, start };
      start += rows.count * this.records.numBytes;
      return rows;
    });
    this.#next = new Float32Array(3 * Math.max(this.records.numJoints, this.records.numBones));
  }

  want() {}

  has() {
    return true;
  }

  positions(person, frame, field, out) {
    const { start_frame: from, num_frames: numFrames, position_step_m: stepM } = this.description.people[person];
    const { first, count, start } = this.#rows[person];
    if (frame < from || frame >= from + numFrames || count === 0) return false;
    const place = Math.min(count - 1, Math.max(0, frame / this.#stride - first));
    const row = Math.floor(place);
    const at = (number) => ({ buffer: this.#buffer, start: start + number * this.records.numBytes });
    this.records.positions(at(row), field, stepM, out);
    if (place > row) between(out, this.records.positions(at(row + 1), field, stepM, this.#next), place - row, out);
    return true;
  }

  close() {}
}

// Preview of edits: a take whose people are put together from the people of another take, until the files of the edits are there.

// Bytes of strips where a person is absent; other columns have 0.
const EMPTY = { error: UNKNOWN_ERROR };

/**
 * Store of a take after edits, from the store of the take before them; it has the methods of `MotionStore`.
 *
 * `before` and `after` are lists of the people of both, `{ id, name, color, pieces }`, and the kept frames, `start_frame`
 * and `stop_frame`. A piece, `{ person, start_frame, stop_frame }`, are frames of a person as found. All frames count in
 * the whole reconstruction. Skeletons come from the earlier fit.
 *
 * Events: the other store's.
 */
export class EditedStore extends EventTarget {
  #base;
  #shift; // frame of the earlier take less frame of this one
  #parts; // of each person: { from, to, source }, frames of this take, and the number of a person of the earlier one
  #forward = (event) => this.dispatchEvent(new Event(event.type));

  constructor(base, before, after) {
    super();
    this.#base = base;
    this.records = base.records;
    this.#shift = after.start_frame - before.start_frame;
    const people = after.people
      .map((person) => ({ person, parts: pieceParts(person, before, after, base.description.people) }))
      .filter(({ parts }) => parts.length > 0);
    this.#parts = people.map(({ parts }) => parts);
    this.description = describe(base.description, before, after, people);
    for (const type of ["load", "problem"]) base.addEventListener(type, this.#forward);
  }

  get problem() {
    return this.#base.problem;
  }

  get numBytes() {
    return this.#base.numBytes;
  }

  /** Fetch what playing from a frame needs. */
  want(frame) {
    this.#base.want(this.#inBase(frame));
  }

  /** True if the frame is here; frames that an earlier cut left out never come. */
  has(frame) {
    const { num_frames: numFrames } = this.#base.description;
    const inBase = frame + this.#shift;
    return inBase < 0 || inBase >= numFrames || this.#base.has(inBase);
  }

  /** Place of a person's record of a frame; null if the person or the frame is not here. */
  place(person, frame) {
    const part = this.#findPart(person, frame);
    return part ? this.#base.place(part.source, frame + this.#shift) : null;
  }

  /** Positions of a person's joints in a frame, as `Records.positions` writes them; whether there are any. */
  positions(person, frame, field, out) {
    const part = this.#findPart(person, frame);
    return part !== undefined && this.#base.positions(part.source, frame + this.#shift, field, out);
  }

  /** Person, by id, and frame in whose files a person's frame is; null if the person is not here. */
  filed(person, frame) {
    const part = this.#findPart(person, frame);
    return part ? this.#base.filed(part.source, frame + this.#shift) : null;
  }

  /** Stop listening to the other store, which stays open. */
  close() {
    for (const type of ["load", "problem"]) this.#base.removeEventListener(type, this.#forward);
  }

  #findPart(person, frame) {
    return this.#parts[person].find(({ from, to }) => frame >= from && frame < to);
  }

  #inBase(frame) {
    return Math.min(this.#base.description.num_frames - 1, Math.max(0, frame + this.#shift));
  }
}

/** Parts of the earlier people of which a person consists, within the kept frames of both takes. */
function pieceParts({ pieces }, before, after, people) {
  const [first, last] = [Math.max(before.start_frame, after.start_frame), Math.min(before.stop_frame, after.stop_frame)];
  const parts = [];
  for (const piece of pieces) {
    for (const { id, pieces: theirs } of before.people) {
      const source = people.findIndex((person) => person.id === id);
      if (source < 0) continue;
      for (const other of theirs) {
        const start = Math.max(piece.start_frame, other.start_frame, first);
        const stop = Math.min(piece.stop_frame, other.stop_frame, last);
        if (other.person === piece.person && start < stop) parts.push({ from: start - after.start_frame, to: stop - after.start_frame, source });
      }
    }
  }
  return parts.sort((one, other) => one.from - other.from);
}

/** Description of the take after edits, as far as it is known before its files are made. */
function describe(base, before, after, people) {
  const shift = after.start_frame - before.start_frame;
  const numFrames = after.stop_frame - after.start_frame;
  return {
    ...base,
    num_frames: numFrames,
    start_time_s: base.start_time_s + shift / base.frame_rate_hz,
    first_frame: after.start_frame,
    first_source_frame: (base.first_source_frame ?? 0) + shift,
    people: people.map(({ person, parts }) => describePerson(base, person, parts, shift)),
    concerns: leftConcerns(base, after, people, shift),
    strips: { ...base.strips, people: people.map(({ parts }) => encodeStrips(base, parts, shift, numFrames)) },
  };
}

/** Places to look at of people who are as they were, but for places that were accepted. */
function leftConcerns(base, { edits, outcomes, first_frame: first, start_frame: start }, people, shift) {
  const accepted = edits.flatMap((edit, index) => (edit.action === "accept" ? [{ ...edit, person: outcomes[index]?.person ?? edit.person }] : []));
  const isLeft = ({ person, camera, kind, start_frame: from, stop_frame: to }) => (person === null || people.some(({ person: { id }, parts }) => id === person && parts.length === 1))
    && !accepted.some((edit) => edit.person === person && edit.camera === camera && edit.kind === kind && edit.start_frame - first - start < to && from < edit.stop_frame - first - start);
  return base.concerns.map((concern) => ({ ...concern, start_frame: concern.start_frame - shift, stop_frame: concern.stop_frame - shift }))
    .filter((concern) => concern.start_frame >= 0 && isLeft(concern));
}

function describePerson(base, { id, name, color }, parts, shift) {
  const about = { id, name, color, start_frame: parts[0].from, num_frames: parts.at(-1).to - parts[0].from, contacts: findContacts(base, parts, shift) };
  const source = base.people[parts[0].source];
  const isWhole = parts.length === 1 && parts[0].from + shift === source.start_frame && about.num_frames === source.num_frames;
  // Figures of a person who is put together again come with the files.
  if (!isWhole) return { ...source, coverage: null, stature_m: null, reprojection_error_px: null, identity: { confidence: NaN, doubts: [] }, ...about };
  const doubts = source.identity.doubts.map((doubt) => ({ ...doubt, frame: doubt.frame - shift }));
  return { ...source, identity: { ...source.identity, doubts }, ...about };
}

function findContacts(base, parts, shift) {
  return parts.flatMap(({ from, to, source }) => base.people[source].contacts.flatMap(([side, part, first, count]) => {
    const [start, stop] = [Math.max(from, first - shift), Math.min(to, first - shift + count)];
    return start < stop ? [[side, part, start, stop - start]] : [];
  }));
}

/** Strips of a person: each bucket comes from the earlier person in its middle. */
function encodeStrips(base, parts, shift, numFrames) {
  const { columns, frames_per_bucket: length } = base.strips;
  const sources = new Map(parts.map(({ source }) => [source, decodeStrips(base, source)]));
  const numBuckets = Math.max(1, Math.ceil(numFrames / length));
  const bytes = new Uint8Array(columns.length * numBuckets);
  columns.forEach((name, column) => {
    for (let bucket = 0; bucket < numBuckets; bucket++) {
      const middle = Math.min(numFrames - 1, bucket * length + (length >> 1));
      const part = parts.find(({ from, to }) => middle >= from && middle < to);
      bytes[column * numBuckets + bucket] = part ? sources.get(part.source)[name][Math.floor((middle + shift) / length)] : EMPTY[name] ?? 0;
    }
  });
  return btoa(String.fromCharCode(...bytes));
}
