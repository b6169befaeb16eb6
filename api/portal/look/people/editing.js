// Edits of a job's people: sent as a whole list, undone, redone, and told when somebody else has changed them.

import { announce } from "../../shared/announce.js";
import { call, readTagged } from "../../shared/api.js";
import { feed } from "../../shared/feed.js";
import { hasEnded } from "../../shared/jobs.js";
import { describe } from "./words.js";

// Event `change`: something that is shown has changed.
export class Editing extends EventTarget {
  people = null; // as of GET /v1/jobs/{id}/people
  problem = null;
  conflict = null; // change that was refused because of somebody else's: { words, change }
  notice = null; // of somebody else's change
  #etag = null;
  #undone = []; // lists before each undo, the last one at the end
  #isSending = false;
  #own = new Set(); // revisions that were made here

  constructor(job) {
    super();
    this.job = job;
  }

  get edits() {
    return this.people.edits;
  }

  // Whether the files of an earlier change are being made.
  get isBusy() {
    return this.#isSending || !hasEnded(this.job);
  }

  get canUndo() {
    return !this.isBusy && this.edits.length > 0;
  }

  get canRedo() {
    return !this.isBusy && this.#undone.length > 0;
  }

  // Take notice of the job as it is now; somebody else may have changed its people.
  async follow(job) {
    const before = this.job;
    this.job = job;
    if (this.people === null || (job.revision > this.people.revision && !this.#isSending)) await this.#read();
    if (before.state !== job.state && hasEnded(job) && job.revision > 0) this.#tellEnd(job);
    this.#changed();
  }

  // Make another edit.
  add(edit) {
    return this.#make(describe(edit, this.people), (edits) => [...edits, edit]);
  }

  // Undo the last edit.
  undo() {
    return this.remove(this.edits.length - 1);
  }

  // Undo an edit, or it and all that follow.
  remove(index, { withLater = false } = {}) {
    const before = this.edits;
    const words = `Undo: ${describe(before[index], this.people)}`;
    const isSame = (edits) => JSON.stringify(edits) === JSON.stringify(before);
    const change = (edits) => (isSame(edits) ? edits.filter((_, number) => number < index || (number > index && !withLater)) : null);
    return this.#make(words, change, () => this.#undone.push(before));
  }

  // Make again what was undone last.
  redo() {
    const list = this.#undone.at(-1);
    return this.#make("Redo", () => list, () => this.#undone.pop());
  }

  // Make the refused change on somebody else's edits.
  repeat() {
    const { words, change } = this.conflict;
    this.conflict = null;
    return this.#make(words, change);
  }

  dismiss() {
    this.conflict = this.notice = this.problem = null;
    this.#changed();
  }

  // Send the list that `change` makes of the present one. Without `done` the change ends what can be redone.
  async #make(words, change, done = () => { this.#undone = []; }) {
    Object.assign(this, { problem: null, conflict: null, notice: null });
    if (this.isBusy) return this.#fail({ message: "The files of the last change are being made.", hint: "Wait until they are there." });
    const edits = change(this.edits);
    this.#isSending = true;
    this.#changed();
    try {
      const job = await call(this.job.links.people, { method: "PATCH", body: { edits }, headers: { "If-Match": this.#etag } });
      this.#own.add(job.revision);
      done();
      await this.#read();
      this.job = job;
      announce(`${words}. The files are being made anew.`);
      feed.put(job);
    } catch (problem) {
      await this.#refused(problem, words, change, edits);
    } finally {
      this.#isSending = false;
      this.#changed();
    }
  }

  async #refused(problem, words, change, edits) {
    const known = this.people.revision;
    if (problem.status === 409) {
      await this.#read().catch(() => null);
      await feed.refresh();
    }
    if (this.people.revision === known) return this.#fail(this.#explained(problem, edits));
    this.#undone = [];
    this.notice = null;
    this.conflict = { words, change: change(this.edits) === null ? null : change };
    announce(`Somebody else has changed the edits meanwhile. Not done: ${words}.`);
  }

  // Problem whose parts name the edit that can't be made in words.
  #explained(problem, edits) {
    for (const item of problem.items) {
      const edit = edits[Number(/^\/edits\/(\d+)/.exec(item.pointer ?? "")?.[1])];
      if (edit) item.field = describe(edit, this.people);
    }
    return problem;
  }

  #fail(problem) {
    this.problem = problem;
    this.#changed();
  }

  async #read() {
    const known = this.people;
    ({ record: this.people, etag: this.#etag } = await readTagged(this.job.links.people));
    if (known === null || this.people.revision === known.revision || this.#own.has(this.people.revision)) return;
    this.#undone = [];
    this.notice = "Somebody else has changed the edits. These are theirs.";
    if (!this.#isSending) announce(this.notice);
  }

  #tellEnd(job) {
    announce(job.state === "succeeded" ? `The files of revision ${job.revision} are there.` : `The files of revision ${job.revision} could not be made.`);
  }

  #changed() {
    this.dispatchEvent(new Event("change"));
  }
}
