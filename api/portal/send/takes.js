// Takes of a dropped folder: captures by the same cameras, which are sent one after another with one calibration and the
// same choices. The draft has one take at a time; those that can't be sent wait until the user mends them.

import { announce } from "../shared/page.js";
import { COUNTS } from "../shared/strings/common.js";
import { SEND } from "../shared/strings/send.js";
import { isSame, detectKind } from "./files.js";
import { takesIn } from "./matching.js";
import { sending } from "./sending.js";

const KEY = "multicap.takes"; // jobs of takes that were sent, so that a folder that is chosen again continues
const MOST_KNOWN = 2000;

// The same files in a folder of the same name have the same text, which is short enough to keep many.
function makeFingerprint({ name, files }) {
  const sum = (fact) => files.reduce((total, file) => total + file[fact], 0);
  return JSON.stringify([name, files.length, sum("size"), sum("lastModified")]);
}

function knownJobs() {
  try {
    return new Map(JSON.parse(localStorage.getItem(KEY)) ?? []);
  } catch {
    return new Map(); // storage is off, or holds something else
  }
}

// State of a take of a folder that may have been sent before.
function takeState(take, known) {
  const id = known.get(makeFingerprint(take));
  return { state: id ? "before" : "waiting", problem: null, job: id ? { id } : null };
}

function remember(take) {
  const known = [...knownJobs().set(makeFingerprint(take), take.job.id)].slice(-MOST_KNOWN);
  try {
    localStorage.setItem(KEY, JSON.stringify(known));
  } catch { /* storage is off or full: a folder that is chosen again is sent again */ }
}

class Takes {
  offered = null; // takes of a dropped folder, until the user says whether they are takes
  list = [];
  isRunning = false;
  #shown = null; // take in the draft
  #sharedId = null; // calibration of the takes without their own
  #ready = null; // promise of the files and the calibration of the take that is put into the draft

  constructor() {
    sending.addEventListener("sent", ({ detail: job }) => this.#sent(job));
  }

  get waiting() { return this.list.filter(({ state }) => state === "waiting"); }

  // Add files to the capture; folders of several takes are shown first. `files` may be a promise.
  async add(read) {
    const files = [...await sending.reading(SEND.unread.files, Promise.resolve(read))];
    if (this.waiting.length === 0 && !this.list.includes(this.#shown)) this.list = [];
    const offered = this.list.length ? null : takesIn(files, await Promise.all(files.map(detectKind)));
    if (offered === null) return sending.add(files);
    this.offered = { ...offered, files };
    announce(SEND.said.folders(COUNTS.folders(offered.takes.length)));
    sending.changed();
  }

  // The folders belong to one capture.
  decline() {
    const { files } = this.offered;
    this.offered = null;
    return sending.add(files);
  }

  // The folders are takes.
  async accept() {
    const { takes, beside } = this.offered;
    this.offered = null;
    const known = knownJobs();
    this.list = takes.map((take) => ({ ...take, ...takeState(take, known) }));
    const [next] = this.waiting;
    if (next) await this.#show(next, beside);
    this.#sharedId = next?.hasCalibration ? null : sending.rig.id;
  }

  #show(take, beside = []) {
    this.#ready = this.#fill(take, beside);
    return this.#ready;
  }

  // Put a take into the draft. An upload of the same files continues.
  async #fill(take, beside) {
    const isInterrupted = sending.rows.length > 0 && sending.rows.every((row) => row.file === null && take.files.some((file) => isSame(row, file)));
    if (!isInterrupted) sending.clear();
    this.#shown = take;
    sending.draft.name = take.name;
    await sending.add([...take.files, ...beside]);
    while (sending.rig.isReading) await new Promise((resolve) => { sending.addEventListener("state", resolve, { once: true }); });
  }

  // Put a take that could not be sent, or was sent before, into the draft.
  async again(take) {
    Object.assign(take, { state: "waiting", job: null });
    await this.#show(take);
  }

  remove(take) {
    this.list = this.list.filter((other) => other !== take);
    sending.changed();
  }

  clear() {
    Object.assign(this, { list: [], offered: null });
    this.#shown = null;
    sending.clear();
  }

  // Send all takes that wait, until the user pauses. A take that fails is named, and the next one follows.
  async run() {
    if (this.isRunning) return;
    this.isRunning = true;
    try {
      await this.#ready;
      for (;;) {
        const take = this.waiting.includes(this.#shown) ? this.#shown : this.waiting[0];
        if (!take) break;
        if (take !== this.#shown) await this.#next(take);
        await sending.send();
        if (!take.hasCalibration) this.#sharedId = sending.rig.id; // that was chosen, or made from its videos
        if (take.state !== "waiting") continue;
        if (sending.problem === null && sending.phase !== "checked") return; // it was paused
        this.#failed(take);
      }
      announce(SEND.said.captures(this.list.filter(({ state }) => state === "sent").length, this.list.length));
    } finally {
      this.isRunning = false;
      sending.changed();
    }
  }

  async #next(take) {
    if (!take.hasCalibration && this.#sharedId !== sending.rig.id) await sending.chooseCalibration(this.#sharedId);
    await this.#show(take);
  }

  // A take that the check refused stays in Captures, with its findings.
  #failed(take) {
    const found = sending.session?.preflight.findings?.filter(({ severity }) => severity === "error") ?? [];
    const problem = sending.problem ?? { message: SEND.said.errors, items: found };
    Object.assign(take, { state: "failed", problem });
  }

  #sent(job) {
    if (this.#shown === null) return;
    Object.assign(this.#shown, { state: "sent", problem: null, job });
    remember(this.#shown);
    this.#shown = null;
  }
}

export const takes = new Takes();
