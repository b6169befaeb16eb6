// View Plan: coverage, views and expected errors of cameras in a room, with a picture.

import { call } from "../shared/api.js";
import { percent } from "../shared/format.js";
import { helpLink, html, nothing, problemBox, render, scrollTable, selectField } from "../shared/lit.js";
import { listed, readCalibrations, usable } from "../shared/resources.js";
import { PLAN } from "../shared/strings/plan.js";

// Fields of new cameras; stored ones have their own values.
const NEW = ["cameras", "height_m", "field_deg"];

export function open(place) {
  let isClosed = false;
  let isBusy = false;
  let standing = ""; // id of the calibration of cameras that stand already
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

  const result = () => html`<section class="panel add" aria-label=${PLAN.result}>
    <p role="status">${PLAN.covered(percent(plan.covered))}</p>
    <img src="data:image/svg+xml,${encodeURIComponent(plan.picture)}" alt=${PLAN.picture}>
    ${scrollTable(PLAN.places, PLAN.table, plan.places.map(({ x_m: x, y_m: y, views, error_mm: error }) => html`<tr><th scope="row">${x}, ${y}</th><td>${views}</td><td>${error ?? PLAN.lost}</td></tr>`))}
  </section>`;

  function draw() {
    if (isClosed) return;
    render(html`<div class="with-help"><h1 class="title">${PLAN.title}</h1>${helpLink("calibration", PLAN.title)}</div>
      <div class="split"><div>${plan ? result() : html`<p class="panel empty">${PLAN.empty}</p>`}</div>
        <form class="panel add" aria-label=${PLAN.title} @submit=${submit}>
          ${selectField(PLAN.stand, [["", PLAN.along], ...listed(calibrations)], { name: "calibration_id", chosen: standing, choose: (id) => { standing = id; draw(); } })}
          ${PLAN.fields.map(([name, label, usual, least, most, step]) => html`<label class="field"><span>${label}</span>
            <input type="number" name=${name} required min=${least} max=${most} step=${step} value=${usual} ?disabled=${standing !== "" && NEW.includes(name)}></label>`)}
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
