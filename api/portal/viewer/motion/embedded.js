// Frames of a take that are in the page itself, as those of a report are.

import { integers } from "./base64.js";
import { between } from "./kinematics.js";
import { about, originOf } from "./nearby.js";
import { FrameRecords } from "./records.js";

/** Store of a report's data (pipeline/export/report); it has the methods of `MotionStore` that views and time line need. */
export class EmbeddedStore extends EventTarget {
  #buffer;
  #stride; // number of frames from a record of a person to the next one; positions in between are interpolated
  #rows; // of each person: number of records, the first one's number among strides, and its place in the buffer
  #next;

  constructor({ frames, stride, ...description }) {
    super();
    this.description = about(description, originOf(description));
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
