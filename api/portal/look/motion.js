// Motion of a job in the view Look: the viewer, and another job of the capture beside it.

import { addressed, call, Problem } from "../shared/api.js";
import { persistently, reached } from "../shared/away.js";
import { html, nothing, render } from "../shared/lit.js";
import { readOptions } from "../shared/options.js";
import { problemBox } from "../shared/problem.js";
import { titlesOf } from "./titles.js";

// Event `time`: the play head has moved, or another viewer is shown.
export class Motion extends EventTarget {
  #viewer = null;
  #startFrame = 0; // frame of the whole reconstruction at which the shown take starts
  #others = [];
  #titles = new Map(); // by id, of the job and the others
  #chosen = null; // job beside this one
  #number = 0; // of what is being opened, so that a slow answer does not open over a later one

  constructor(place) {
    super();
    this.choice = document.createElement("div");
    this.stage = document.createElement("div");
    place.append(this.choice, this.stage);
  }

  /** Frame of the whole reconstruction at the play head; null outside of the job's take. */
  get frame() {
    const frame = this.#viewer?.frame ?? null;
    return frame === null ? null : frame + this.#startFrame;
  }

  /** Move the play head to a frame of the whole reconstruction. */
  seek(frame) {
    this.#viewer?.goTo(frame - this.#startFrame);
  }

  /** Show a job of a session; `startFrame` as edits cut it. `isGuest`: by a link, which opens no other job. */
  async open(job, session, { startFrame = 0, isGuest = false } = {}) {
    Object.assign(this, { job, session });
    this.#startFrame = startFrame;
    await this.#show(this.#chosen);
    if (isGuest) return;
    const { jobs } = await call(`/v1/sessions/${session.id}/jobs?state=succeeded`);
    this.#others = jobs.filter((one) => one.id !== job.id && one.kind === "reconstruction");
    this.#titles = titlesOf([job, ...this.#others], await readOptions());
    this.#drawChoice();
  }

  close() {
    this.#number += 1;
    this.#viewer?.close();
    this.#viewer = null;
  }

  async #show(other) {
    const before = this.#viewer?.standpoint ?? null;
    const hadFocus = this.stage.contains(document.activeElement);
    // What is below stays where it is while the motion is loaded.
    this.stage.style.minHeight = before === null ? "" : `${this.stage.offsetHeight}px`;
    this.close();
    this.#chosen = other;
    const number = this.#number;
    try {
      const isOver = () => number !== this.#number;
      const viewer = await persistently(() => this.#mounted(other), { isOver, away: (problem) => this.#tell(problem) });
      if (number !== this.#number) return viewer.close();
      this.#viewer = viewer;
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
  async #mounted(other) {
    try {
      const [{ mount, mountPair }, { ApiSource }] = await Promise.all([import("../viewer/mount.js"), import("../viewer/source.js")]);
      const { cameras } = this.session.preflight;
      const sourceOf = ({ id }) => new ApiSource(id, cameras, addressed);
      return other === null
        ? await mount(this.stage, sourceOf(this.job))
        : await mountPair(this.stage, [this.job, other].map(sourceOf), [this.job, other].map(({ id }) => this.#titles.get(id)));
    } catch (error) {
      throw await reached() ? error : new Problem(null);
    }
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
    render(this.#others.length === 0 ? nothing : html`<label class="compare">Compare with
      <select @change=${choose}><option value="">no other job</option>
        ${this.#others.map((one) => html`<option value=${one.id} .selected=${one.id === this.#chosen?.id}>${this.#titles.get(one.id)}</option>`)}
      </select></label>`, this.choice);
  }
}
