// Part of the view Send that chooses the calibration of the cameras: a stored one, or a file.

import { dated, usable } from "../shared/calibrations.js";
import { count } from "../shared/format.js";
import { html, live, nothing } from "../shared/lit.js";
import { problemBox, warningList } from "../shared/problem.js";
import { ACCEPTED_CALIBRATIONS, AXES } from "./files.js";

const UNITS = [["", "as the file states, or metres"], ["m", "metres"], ["cm", "centimetres"], ["mm", "millimetres"]];

function factsOf(calibration) {
  const sizes = [...new Set(calibration.cameras.map(({ size_px: px }) => (px ? px.join(" × ") : "size unknown")))];
  const errors = (calibration.report?.cameras ?? []).map((camera) => camera.reprojection_error_px).filter((errorPx) => errorPx != null);
  const facts = [count(calibration.cameras.length, "camera"), sizes.join(", ")];
  if (errors.length) facts.push(`error ${Math.max(...errors).toFixed(2)} px at most`);
  if (calibration.source.units) facts.push(`in ${calibration.source.units}`);
  return facts.join(" · ");
}

const choice = (name, choices, chosen, isLocked, choose) => html`<label class="field unit"><span>${name}</span>
  <select ?disabled=${isLocked} @change=${(event) => choose(event.target.value || null)}>
    ${choices.map(([value, label]) => html`<option value=${value} .selected=${live(value === (chosen ?? ""))}>${label}</option>`)}</select></label>`;

export function calibrationPart({ sending, stored, away, choose, readFile, isLocked }) {
  const ready = usable(stored ?? []);
  const { rig } = sending;
  const chosen = sending.capture.calibration;
  // The list may be older than the chosen calibration.
  const listed = rig.id && !ready.some(({ id }) => id === rig.id) ? [chosen ?? { id: rig.id, name: rig.name ?? "…" }, ...ready] : ready;
  return html`
    <div class="pair">
      <label class="field"><span>Stored calibration</span>
        <select ?disabled=${isLocked} @change=${(event) => choose(event.target.value, listed.find(({ id }) => id === event.target.value)?.name)}>
          <option value="" .selected=${live(!rig.id)}>${stored === null ? "Loading …" : listed.length ? "Choose …" : "None is stored yet"}</option>
          ${listed.map((calibration) => html`<option value=${calibration.id} .selected=${live(calibration.id === rig.id)}>${dated(calibration)}</option>`)}
        </select>
      </label>
      <label class="field"><span>Or a calibration file</span>
        <input type="file" accept=${ACCEPTED_CALIBRATIONS} ?disabled=${isLocked}
          @change=${(event) => { if (event.target.files.length) readFile(event.target.files[0]); event.target.value = ""; }}>
      </label>
    </div>
    ${problemBox(away && { message: `The stored calibrations can't be loaded. ${away.message}` })}
    ${rig.isReading ? html`<p class="chosen" role="status"><b>${rig.name ?? ""}</b> <span class="quiet">Checking the calibration …</span></p>` : nothing}
    ${chosen ? html`<p class="chosen"><b>${chosen.name}</b> <span class="quiet">${factsOf(chosen)}</span></p>
      ${warningList(chosen.warnings, "Warnings about the calibration")}` : nothing}
    ${rig.file ? html`<div class="pair">
      ${choice("Unit of length", UNITS, rig.units, isLocked, (units) => readFile(rig.file, units, rig.up))}
      ${choice("Axis that points up", AXES, rig.up, isLocked, (up) => readFile(rig.file, rig.units, up))}</div>` : nothing}
    <p class="quiet">No calibration yet? <a href="#/calibrations">Make one from footage of a board or of people.</a></p>`;
}
