// Motion of a job: the viewer, and another job of the capture beside it.

import { addressed, call, persistently, reached, RequestProblem } from "../shared/api.js";
import { html, nothing, problemBox, render } from "../shared/lit.js";
import { readOptions } from "../shared/resources.js";
import { TAKE } from "../shared/strings/take.js";
import { about } from "../viewer/motion/records.js";
import { EditedStore, MotionStore } from "../viewer/motion/store.js";
import { titleJobs } from "./titles.js";

// Event `time`: the play head has moved, or another viewer is shown.
export class JobMotion extends EventTarget {
  #viewer = null;
  #source = null; // of the job's motion
  #store = null; // frames of the files, also while a preview of edits is shown
  #others = [];
  #titles = new Map(); // by id, of the job and the others
  #chosen = null; // job beside this one
  #number = 0; // of what is being opened, so that a slow answer does not open over a later one
  #edited = null; // people who are shown before their files are there
  #tool = null; // to correct joints
  #pending = [[], 0]; // corrections of joints whose files are not there, and the frame with which they count

  constructor(place) {
    super();
    this.choice = document.createElement("div"); // of the other job, for the view to show
    this.stage = place;
  }

  /** Frame of the whole reconstruction at the play head; null outside of the job's take. */
  get frame() {
    const frame = this.#viewer?.frame ?? null;
    return frame === null ? null : frame + this.#viewer.description.first_frame;
  }

  /** Move the play head to a frame of the whole reconstruction. */
  seek(frame) {
    this.#viewer?.goTo(frame - this.#viewer.description.first_frame);
  }

  /** Show a job of a session, or its new files. `isGuest`: by a link, which opens no other job. `editor` makes edits. */
  async open(job, session, { isGuest = false, editor = null } = {}) {
    Object.assign(this, { job, session, editor });
    if (this.#viewer === null) await this.#show(this.#chosen);
    else await this.#renew();
    if (isGuest) return;
    const { jobs } = await call(`/v1/sessions/${session.id}/jobs?state=succeeded`);
    this.#others = jobs.filter((other) => other.id !== job.id && other.kind === "reconstruction");
    this.#titles = titleJobs([job, ...this.#others], await readOptions());
    this.#drawChoice();
  }

  /**
   * Show the people of edits whose files are not there yet, `{ before, after }` like `EditedStore`: the people of the files, and
   * the people of the edits. Null: show the files.
   */
  preview(edited) {
    if (edited?.before === this.#edited?.before && edited?.after === this.#edited?.after) return;
    this.#edited = edited;
    this.#showPeople();
  }

  /** Preview corrections of joints whose files are not there yet. `firstFrame` of the session is the first one of the run. */
  previewJoints(edits, firstFrame) {
    this.#pending = [edits, firstFrame];
    this.#tool?.follow(edits, firstFrame);
  }

  close() {
    this.#number += 1;
    this.#tool?.close();
    this.#tool = null;
    this.#viewer?.close();
    if (this.#viewer?.store !== this.#store) this.#store?.close();
    this.#viewer = this.#store = null;
  }

  // Show new files of the job in the viewer that is open: videos and view stay.
  async #renew() {
    const number = ++this.#number;
    const isOver = () => number !== this.#number;
    const origin = this.#viewer.description.origin_m;
    const read = async () => {
      const description = about(await this.#source.description(), origin);
      return new MotionStore(description, this.#source);
    };
    const store = await persistently(() => orAway(read), { isOver });
    // No person disappears until the frames are there.
    await store.loaded(this.frame === null ? 0 : this.frame - store.description.first_frame);
    if (isOver()) return store.close();
    const earlier = this.#store;
    this.#store = store;
    this.#edited = null;
    this.#showPeople();
    earlier.close();
  }

  #showPeople() {
    if (this.#viewer === null) return;
    const before = this.#viewer.store;
    const store = this.#edited === null ? this.#store : new EditedStore(this.#store, this.#edited.before, this.#edited.after);
    if (store === before) return;
    this.#viewer.replace(store);
    if (before instanceof EditedStore) before.close();
    this.#tool?.follow(...this.#pending);
    this.#moved();
  }

  async #show(other) {
    const before = this.#viewer?.standpoint ?? null;
    const hadFocus = this.stage.contains(document.activeElement);
    // The content below stays in its place while the motion is loaded.
    this.stage.style.minHeight = before === null ? "" : `${this.stage.offsetHeight}px`;
    this.close();
    this.#chosen = other;
    const number = this.#number;
    try {
      const isOver = () => number !== this.#number;
      const viewer = await persistently(() => this.#mounted(other), { isOver, away: (problem) => this.#tell(problem) });
      if (number !== this.#number) return viewer.close();
      this.#viewer = viewer;
      this.#store = viewer.store;
      if (this.editor !== null) this.#tool = await import("./corrections/joint_tool.js").then(({ JointTool }) => new JointTool(viewer, this.editor));
      this.#showPeople();
      this.#tool?.follow(...this.#pending);
      if (before !== null) viewer.resume(before);
      if (hadFocus) this.stage.querySelector("canvas, button")?.focus({ preventScroll: true });
      viewer.player.addEventListener("time", () => this.#moved());
      this.#moved();
    } catch (problem) {
      if (number === this.#number) this.#tell(problem);
    } finally {
      if (number === this.#number) this.stage.style.minHeight = "";
    }
  }

  // Viewer of the job, or of it and another one.
  #mounted(other) {
    return orAway(async () => {
      const { ApiSource, mount, mountPair } = await import("../viewer/mount.js");
      const { cameras } = this.session.preflight;
      const openSource = ({ id, spec }) => new ApiSource(id, cameras, addressed, { hasCharacter: Boolean(spec.character), fileRateHz: spec.output_rate_hz });
      this.#source = openSource(this.job);
      return other === null
        ? mount(this.stage, this.#source, { editor: this.editor })
        : mountPair(this.stage, [this.#source, openSource(other)], [this.job, other].map(({ id }) => this.#titles.get(id)));
    });
  }

  #tell(problem) {
    const place = document.createElement("div");
    this.stage.replaceChildren(place);
    render(problemBox(problem), place);
  }

  #moved() {
    this.dispatchEvent(new Event("time"));
  }

  #drawChoice() {
    const choose = (event) => this.#show(this.#others.find(({ id }) => id === event.target.value) ?? null);
    render(this.#others.length === 0 ? nothing : html`<label class="compare">${TAKE.compare}
      <select @change=${choose}><option value="">${TAKE.noOther}</option>
        ${this.#others.map((other) => html`<option value=${other.id} .selected=${other.id === this.#chosen?.id}>${this.#titles.get(other.id)}</option>`)}
      </select></label>`, this.choice);
  }
}

// Result of a task; its problem, or that the service is away.
async function orAway(task) {
  try {
    return await task();
  } catch (error) {
    throw await reached() ? error : new RequestProblem(null);
  }
}
