// Plan of a rig: coverage, views and expected errors of cameras in a room, with a picture.

import { call } from "../shared/api.js";
import { percent } from "../shared/format.js";
import { html, nothing, problemBox } from "../shared/lit.js";
import { dated } from "../shared/resources.js";
import { CALIBRATIONS } from "../shared/strings/calibrations.js";

const { plan: PLAN } = CALIBRATIONS;
// Fields of new cameras; stored ones have their own values.
const NEW = ["cameras", "height_m", "field_deg"];
const MIDDLE = 4; // of the nine places

export class RigPlan {
  #plan = null;
  #problem = null;
  #isBusy = false;
  #isNew = true;

  constructor(draw) {
    this.draw = draw;
  }

  async #submit(event) {
    event.preventDefault();
    if (this.#isBusy) return;
    this.#isBusy = true;
    this.#problem = null;
    this.draw();
    const fields = [...new FormData(event.target)].filter(([, value]) => value !== "");
    try {
      this.#plan = await call(`/v1/calibrations/plan?${new URLSearchParams(fields)}`);
    } catch (problem) {
      this.#problem = problem;
    }
    this.#isBusy = false;
    this.draw();
  }

  // Panel with the form and its result; cameras of `calibrations` may stand already.
  panel(calibrations) {
    const choose = ({ target }) => {
      this.#isNew = target.value === "";
      this.draw();
    };
    return html`<form class="panel add" aria-labelledby="plan-title" @submit=${(event) => this.#submit(event)}>
      <h2 id="plan-title">${PLAN.title}</h2>
      <label class="field"><span>${PLAN.stand}</span><select name="calibration_id" @change=${choose}><option value="">${PLAN.along}</option>
        ${calibrations.map((each) => html`<option value=${each.id}>${dated(each)}</option>`)}</select></label>
      <div class="pair">${PLAN.fields.map(([name, label, usual, least, most, step]) => html`<label class="field"><span>${label}</span>
        <input type="number" name=${name} required min=${least} max=${most} step=${step} value=${usual} ?disabled=${!this.#isNew && NEW.includes(name)}></label>`)}</div>
      <div class="actions"><button class="button" aria-disabled=${this.#isBusy ? "true" : nothing}>${PLAN.submit}</button></div>
      ${this.#plan ? html`<p role="status">${PLAN.covered(percent(this.#plan.covered))} ${PLAN.middle(this.#plan.places[MIDDLE])}</p>
        <img class="plan" src="data:image/svg+xml,${encodeURIComponent(this.#plan.picture)}" alt=${PLAN.picture}>` : nothing}
      ${problemBox(this.#problem)}</form>`;
  }
}
