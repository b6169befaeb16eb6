// View Plan: coverage, views and expected errors of cameras in a room, with a picture.

import { call } from "../shared/api.js";
import { percent } from "../shared/format.js";
import { helpLink, html, nothing, problemBox, render } from "../shared/lit.js";
import { dated, readCalibrations, usable } from "../shared/resources.js";
import { PLAN } from "../shared/strings/plan.js";

// Fields of new cameras; stored ones have their own values.
const NEW = ["cameras", "height_m", "field_deg"];

export function open(place) {
  let isClosed = false;
  let isBusy = false;
  let isNew = true;
  let calibrations = [];
  let plan = null;
  let problem = null;

  async function submit(event) {
    event.preventDefault();
    if (isBusy) return;
    isBusy = true;
    problem = null;
    draw();
    const fields = [...new FormData(event.target)].filter(([, value]) => value !== "");
    try {
      plan = await call(`/v1/calibrations/plan?${new URLSearchParams(fields)}`);
    } catch (refused) {
      problem = refused;
    }
    isBusy = false;
    draw();
  }

  function choose({ target }) {
    isNew = target.value === "";
    draw();
  }

  const result = () => html`<section class="panel add" aria-label=${PLAN.result}>
    <p role="status">${PLAN.covered(percent(plan.covered))}</p>
    <img src="data:image/svg+xml,${encodeURIComponent(plan.picture)}" alt=${PLAN.picture}>
    <div class="scroll" role="group" aria-label=${PLAN.places} tabindex="0"><table><thead><tr>${PLAN.table.map((head) => html`<th scope="col">${head}</th>`)}</tr></thead>
      <tbody>${plan.places.map(({ x_m: x, y_m: y, views, error_mm: error }) => html`<tr><th scope="row">${x}, ${y}</th><td>${views}</td><td>${error ?? PLAN.lost}</td></tr>`)}</tbody></table></div>
  </section>`;

  function draw() {
    if (isClosed) return;
    render(html`<div class="with-help"><h1 class="title">${PLAN.title}</h1>${helpLink("calibration", PLAN.title)}</div>
      <div class="split"><div>${plan ? result() : html`<p class="panel empty">${PLAN.empty}</p>`}</div>
        <form class="panel add" aria-label=${PLAN.title} @submit=${submit}>
          <label class="field"><span>${PLAN.stand}</span><select name="calibration_id" @change=${choose}><option value="">${PLAN.along}</option>
            ${calibrations.map((each) => html`<option value=${each.id}>${dated(each)}</option>`)}</select></label>
          ${PLAN.fields.map(([name, label, usual, least, most, step]) => html`<label class="field"><span>${label}</span>
            <input type="number" name=${name} required min=${least} max=${most} step=${step} value=${usual} ?disabled=${!isNew && NEW.includes(name)}></label>`)}
          <div class="actions"><button class="button primary" aria-disabled=${isBusy ? "true" : nothing}>${PLAN.submit}</button></div>
          ${problemBox(problem)}</form></div>`, place);
  }

  draw();
  readCalibrations().then((found) => {
    calibrations = usable(found);
    draw();
  }).catch((refused) => {
    problem = refused;
    draw();
  });
  return { title: PLAN.title, close() { isClosed = true; } };
}
