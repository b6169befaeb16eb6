// The calibration of the capture. One that is being read takes the place of the one before at once, so that neither the page
// nor a request speaks of the former one.

import { call } from "../shared/api.js";
import { persistently } from "../shared/away.js";
import { storedCalibration } from "./calibration_file.js";

const NONE = { id: null, name: null, file: null, units: null, up: null, record: null, problem: null, isReading: false };

export class ChosenCalibration {
  #number = 0; // of the last choice, so that a slow answer does not take the place of a later one

  // `changed` is called after each change.
  constructor(changed) {
    Object.assign(this, NONE, { changed });
  }

  // Choose a stored calibration; null: none.
  choose(id, name = null) {
    if (id) return this.#read({ id, name }, () => call(`/v1/calibrations/${encodeURIComponent(id)}`));
    this.#number += 1;
    Object.assign(this, NONE);
    this.changed();
    return Promise.resolve();
  }

  // Store a calibration file, which checks it; the capture names it by its id.
  readFile(file, units = null, up = null) {
    return this.#read({ name: file.name, file, units, up }, () => storedCalibration(file, units, up));
  }

  async #read(wanted, read) {
    const number = ++this.#number;
    Object.assign(this, NONE, wanted, { isReading: true });
    this.changed();
    let result;
    try {
      const isOver = () => number !== this.#number;
      const record = await persistently(read, { isOver, away: (problem) => { this.problem = problem; this.changed(); } });
      result = { record, id: record.id, name: record.name, problem: null };
    } catch (problem) {
      result = { problem, ...(problem.status === 404 && { id: null }) };
    }
    if (number !== this.#number) return;
    Object.assign(this, result, { isReading: false });
    this.changed();
  }
}
