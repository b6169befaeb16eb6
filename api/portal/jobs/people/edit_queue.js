// Edits of a job's people: shown at once, sent one after the other, undone, redone, and told when somebody else has changed them.

import { call, persistently, readTagged } from "../../shared/api.js";
import { feed } from "../../shared/feed.js";
import { hasEnded } from "../../shared/jobs.js";
import { announce } from "../../shared/page.js";
import { PEOPLE } from "../../shared/strings/take.js";
import { describe } from "./person_names.js";

// Event `change`: something that is shown has changed.
export class EditQueue extends EventTarget {
  people = null; // from GET /v1/jobs/{id}/people
  problem = null;
  conflict = null; // changes that were refused because of somebody else's: { words, changes }
  notice = null; // of somebody else's change
  #etag = null;
  #waiting = []; // changes that the service does not have yet: { words, change }; the first one is being sent
  #undone = []; // lists before each undo, the last one at the end
  #own = new Set(); // revisions that were made here
  #earlier = new Map(); // people by revision, as far as they were read here
  #isClosed = false;

  constructor(job) {
    super();
    this.job = job;
  }

  // List of edits with all changes that wait.
  get edits() {
    return this.#waiting.reduce((edits, { change }) => change(edits) ?? edits, this.people.edits);
  }

  // Whether a change is on its way to the service.
  get isSending() {
    return this.#waiting.length > 0;
  }

  close() {
    this.#isClosed = true;
  }

  get canUndo() {
    return this.edits.length > 0;
  }

  get canRedo() {
    return this.#undone.length > 0;
  }

  // People of an earlier revision; undefined if it was not read here.
  peopleAt(revision) {
    return this.#earlier.get(revision);
  }

  // Take notice of the job as it is now; somebody else may have changed its people.
  async follow(job) {
    const before = this.job;
    this.job = job;
    for (const revision of this.#earlier.keys()) if (revision < job.results_revision) this.#earlier.delete(revision);
    if (this.people === null || (job.revision > this.people.revision && !this.isSending)) await this.#read();
    if (!hasEnded(before) && hasEnded(job) && job.revision > 0) this.#tellEnd(job);
    this.#changed();
  }

  // Make another edit.
  add(edit) {
    this.#undone = [];
    return this.#make(describe(edit, this.people), (edits) => [...edits, edit]);
  }

  // Undo the last edit.
  undo() {
    return this.remove(this.edits.length - 1);
  }

  // Undo an edit, or it and all that follow.
  remove(index, { withLater = false } = {}) {
    const before = this.edits;
    const isSame = (edits) => JSON.stringify(edits) === JSON.stringify(before);
    const change = (edits) => (isSame(edits) ? edits.filter((_, number) => number < index || (number > index && !withLater)) : null);
    this.#undone.push(before);
    return this.#make(PEOPLE.actions.undo(describe(before[index], this.people)), change);
  }

  // Make again what was undone last.
  redo() {
    const list = this.#undone.pop();
    return this.#make(PEOPLE.actions.redo, () => list);
  }

  // Make the refused changes on somebody else's edits.
  repeat() {
    const { changes } = this.conflict;
    this.conflict = null;
    return Promise.all(changes.map(({ words, change }) => this.#make(words, change)));
  }

  dismiss() {
    this.conflict = this.notice = this.problem = null;
    this.#changed();
  }

  // Show a change of the list, and send it after those that wait. Returns a promise that is kept when the service has answered.
  #make(words, change) {
    Object.assign(this, { problem: null, conflict: null, notice: null });
    const made = new Promise((settle) => this.#waiting.push({ words, change, settle }));
    this.#changed();
    if (this.#waiting.length === 1) this.#sendAll();
    return made;
  }

  async #sendAll() {
    while (this.#waiting.length > 0) {
      const [{ words, change, settle }] = this.#waiting;
      const edits = change(this.people.edits);
      try {
        if (edits !== null) await this.#send(edits, words);
        else this.#waiting.shift(); // of a list that never came to be, since a change before it was refused
      } catch (problem) {
        await this.#refused(problem, edits);
      }
      settle();
      this.#changed();
    }
  }

  // Send a list as soon as the service can be reached.
  async #send(edits, words) {
    const request = { method: "PUT", body: { edits }, headers: { "If-Match": this.#etag } };
    const isOver = () => this.#isClosed;
    const job = await persistently(() => call(this.job.urls.people, request), { isOver });
    this.#own.add(job.revision);
    await persistently(() => this.#read(), { isOver });
    this.#waiting.shift();
    this.job = job;
    announce(PEOPLE.said.sent(words));
    feed.put(job);
  }

  // Give the change up that was sent. If somebody else has changed the edits, those that wait are given up with it.
  async #refused(problem, edits) {
    const known = this.people.revision;
    if ([409, 412].includes(problem.status)) {
      await this.#read().catch(() => null);
      await feed.refresh();
    }
    // The answer to the same request was lost.
    if (JSON.stringify(this.people.edits) === JSON.stringify(edits) && this.people.revision > known) {
      this.#waiting.shift();
      this.notice = null;
      return;
    }
    this.#undone = [];
    if (this.people.revision === known) {
      this.#waiting.shift();
      this.problem = this.#explained(problem, edits);
      return;
    }
    const given = this.#waiting.splice(0);
    for (const { settle } of given) settle();
    this.notice = null;
    const words = given.map((edit) => edit.words).join("; ");
    this.conflict = { words, changes: given.filter(({ change }) => change(this.people.edits) !== null) };
    announce(PEOPLE.said.refused(words));
  }

  // Problem whose parts name the edit that can't be made in words.
  #explained(problem, edits) {
    for (const item of problem.items ?? []) {
      const edit = edits[Number(/^\/edits\/(\d+)/.exec(item.pointer ?? "")?.[1])];
      if (edit) item.field = describe(edit, this.people);
    }
    return problem;
  }

  async #read() {
    const known = this.people;
    ({ record: this.people, etag: this.#etag } = await readTagged(this.job.urls.people));
    this.#earlier.set(this.people.revision, this.people);
    if (known === null || this.people.revision === known.revision || this.#own.has(this.people.revision)) return;
    this.#undone = [];
    this.notice = PEOPLE.othersEdits;
    if (!this.isSending) announce(this.notice);
  }

  #tellEnd(job) {
    announce(PEOPLE.said[job.files_state === "current" ? "ready" : "failed"](job.revision));
  }

  #changed() {
    this.dispatchEvent(new Event("change"));
  }
}
