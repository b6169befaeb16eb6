// Motion of a job in the view Look: the viewer, and another job of the capture beside it.

import { call } from "../shared/api.js";
import { moment } from "../shared/format.js";
import { html, nothing, render } from "../shared/lit.js";
import { problemBox } from "../shared/problem.js";

export class Motion {
  #viewer = null;
  #others = [];
  #number = 0; // of what is being opened, so that a slow answer does not open over a later one

  constructor(place) {
    this.choice = document.createElement("div");
    this.stage = document.createElement("div");
    place.append(this.choice, this.stage);
  }

  /** Show a job of a session. */
  async open(job, session) {
    Object.assign(this, { job, session });
    await this.#show(null);
    const { jobs } = await call(`/v1/sessions/${session.id}/jobs?state=succeeded`);
    this.#others = jobs.filter((one) => one.id !== job.id && one.kind === "reconstruction");
    this.#drawChoice("");
  }

  close() {
    this.#number += 1;
    this.#viewer?.close();
    this.#viewer = null;
  }

  async #show(other) {
    this.close();
    const number = this.#number;
    try {
      const [{ mount, mountPair }, { ApiSource }] = await Promise.all([import("../viewer/mount.js"), import("../viewer/source.js")]);
      const { cameras } = this.session.preflight;
      const sourceOf = ({ id }) => new ApiSource(id, cameras);
      const viewer = other === null
        ? await mount(this.stage, sourceOf(this.job))
        : await mountPair(this.stage, [this.job, other].map(sourceOf), [this.job, other].map(titleOf));
      if (number === this.#number) this.#viewer = viewer;
      else viewer.close();
    } catch (problem) {
      if (number === this.#number) render(problemBox(problem), this.stage);
    }
  }

  #drawChoice(chosen) {
    const choose = (event) => this.#show(this.#others.find(({ id }) => id === event.target.value) ?? null);
    render(this.#others.length === 0 ? nothing : html`<label class="compare">Compare with
      <select @change=${choose}><option value="">no other job</option>
        ${this.#others.map((one) => html`<option value=${one.id} ?selected=${one.id === chosen}>${titleOf(one)}</option>`)}
      </select></label>`, this.choice);
  }
}

/** Title of a job among those of its session: when it was started, and the choices that differ most often. */
function titleOf({ created_at: created, spec }) {
  return [moment(created), spec?.method, spec?.profile, spec?.smoothing].filter(Boolean).join(", ");
}
