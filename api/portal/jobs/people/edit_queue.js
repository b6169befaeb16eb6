// Edits of a capture in the run of a job: shown at once, sent one after the other, undone, redone, and told when another client has changed them.

import { call, persistently, readTagged } from "../../shared/api.js";
import { feed } from "../../shared/feed.js";
import { hasEnded } from "../../shared/jobs.js";
import { announce } from "../../shared/page.js";
import { PEOPLE } from "../../shared/strings/take.js";
import { describe } from "./person_names.js";

const FRAMES = ["frame", "start_frame", "stop_frame"];

// Compare two lists of edits, but for the names of people: the service puts places for numbers.
const areAlike = (one, other) => JSON.stringify(one.map(unnamed)) === JSON.stringify(other.map(unnamed));
const unnamed = ({ person, other, ...rest }) => rest;

// Edits and the people of the run, whose frames count from its first one.
function ofRun({ revision, edits, run }) {
  const moved = (record) => ({ ...record, start_frame: record.start_frame - run.first_frame, ...("stop_frame" in record && { stop_frame: record.stop_frame - run.first_frame }) });
  const people = run.people.map((person) => ({ ...person, pieces: person.pieces.map(moved) }));
  return { ...moved(run), revision, edits, people };
}

// Event `change`: something that is shown has changed.
export class EditQueue extends EventTarget {
  people = null; // edits of GET /v1/sessions/{id}/edits, with the people of the run, whose frames count from its first one
  problem = null;
  conflict = null; // changes that were refused because of another user's: { words, changes }
  notice = null; // of another user's change
  #etag = null;
  #waiting = []; // changes that the service does not have yet: { words, change }; the first one is being sent
  #undone = []; // lists before each undo, the last one at the end
  #own = new Set(); // revisions of the edits that were made here
  #earlier = new Map(); // people by revision of the edits, as far as they were read here
  #applied = new Map(); // revisions of the edits by revision of the job's files
  #isClosed = false;

  constructor(job) {
    super();
    this.job = job;
  }

  // List of edits with all changes that wait.
  get edits() {
    return this.#waiting.reduce((edits, { change }) => change(edits) ?? edits, this.people.edits);
  }

  // True if a change is on its way to the service.
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

  // People of the job's files of a revision; undefined if they were not read here.
  peopleAt(revision) {
    return this.#earlier.get(this.#applied.get(revision));
  }

  // True if the files show earlier edits of the capture, or none of them, and nothing is being done about it.
  get isBehind() {
    return !this.isSending && hasEnded(this.job) && this.job.edits_revision !== this.job.newest_edits_revision;
  }

  // Take notice of the job as it is now; another user may have changed its people.
  async follow(job) {
    const before = this.job;
    this.job = job;
    this.#applied.set(job.revision, job.edits_revision);
    const shown = this.#applied.get(job.results_revision);
    for (const revision of this.#earlier.keys()) if (revision < shown) this.#earlier.delete(revision);
    if (this.people === null || (job.newest_edits_revision > this.people.revision && !this.isSending)) await this.#read();
    if (!hasEnded(before) && hasEnded(job) && job.revision > 0) this.#tellEnd(job);
    this.#changed();
  }

  // Make another edit.
  add(edit) {
    this.#undone = [];
    const words = describe(edit, this.people);
    const { first_frame: first } = this.people;
    const inSession = { ...edit };
    for (const name of FRAMES) if (typeof edit[name] === "number") inSession[name] += first;
    return this.#make(words, (edits) => [...edits, inSession]);
  }

  // Undo the last edit.
  undo() {
    return this.remove(this.edits.length - 1);
  }

  // Undo an edit.
  remove(index) {
    const before = this.edits;
    const change = (edits) => (areAlike(edits, before) ? edits.filter((_, number) => number !== index) : null);
    this.#undone.push(before);
    return this.#make(PEOPLE.actions.undo(this.wordsOf(index)), change);
  }

  // An edit of the list in words.
  wordsOf(index) {
    const { outcomes, first_frame: first } = this.people;
    return describe(this.edits[index], this.people, { outcome: outcomes[index], first });
  }

  // Make the files again with the edits of the capture.
  async apply() {
    feed.put(await call(this.job.urls.files, { method: "POST", body: { apply_edits: true } }));
  }

  // Make again what was undone last.
  redo() {
    const list = this.#undone.pop();
    return this.#make(PEOPLE.actions.redo, () => list);
  }

  // Make the refused changes on another user's edits.
  repeat() {
    const { changes } = this.conflict;
    this.conflict = null;
    return Promise.all(changes.map(({ words, change }) => this.#make(words, change)));
  }

  dismiss() {
    this.conflict = this.notice = this.problem = null;
    this.#changed();
  }

  // Show why something could not be done.
  fail(problem) {
    this.problem = problem;
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
    const request = { method: "PUT", body: { edits, job_id: this.job.id }, headers: { "If-Match": this.#etag } };
    const isOver = () => this.#isClosed;
    const { revision } = await persistently(() => call(`${this.job.urls.session}/edits`, request), { isOver });
    this.#own.add(revision);
    const [job] = await persistently(() => Promise.all([call(this.job.urls.self), this.#read()]), { isOver });
    this.#waiting.shift();
    this.#applied.set(job.revision, job.edits_revision);
    this.job = job;
    announce(PEOPLE.said.sent(words));
    feed.put(job);
  }

  // Give the change up that was sent. If another user has changed the edits, those that wait are given up with it.
  async #refused(problem, edits) {
    const known = this.people.revision;
    if ([409, 412].includes(problem.status)) {
      await this.#read().catch(() => null);
      await feed.refresh();
    }
    // The answer to the same request was lost.
    if (areAlike(this.people.edits, edits) && this.people.revision > known) {
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
      const { outcomes, first_frame: first } = this.people;
      if (edit) item.field = describe(edit, this.people, { outcome: outcomes[edits.indexOf(edit)], first });
    }
    return problem;
  }

  async #read() {
    const known = this.people;
    const { record, etag } = await readTagged(this.job.urls.edits);
    [this.people, this.#etag] = [ofRun(record), etag];
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
