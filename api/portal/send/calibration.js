// Part of the view Send that chooses the calibration of the cameras: a stored one, a file, or one made from the videos.

import { boardFields, statureField } from "../calibrations/fields.js";
import { call, jsonPart, persistently } from "../shared/api.js";
import { stem } from "../shared/format.js";
import { html, live, nothing, problemBox, selectField, warningList } from "../shared/lit.js";
import { dated, usable } from "../shared/resources.js";
import { COMMON, COUNTS } from "../shared/strings/common.js";
import { SEND } from "../shared/strings/send.js";
import { ACCEPTED_CALIBRATIONS, AXES } from "./files.js";

const TEXT = SEND.calibration;

function calibrationFacts(calibration) {
  const sizes = [...new Set(calibration.cameras.map(({ size_px: px }) => (px ? px.join(" × ") : TEXT.sizeUnknown)))];
  const errors = (calibration.report?.cameras ?? []).map((camera) => camera.reprojection_error_px).filter((errorPx) => errorPx != null);
  const facts = [COUNTS.cameras(calibration.cameras.length), sizes.join(", ")];
  if (errors.length) facts.push(TEXT.largestError(Math.max(...errors).toFixed(2)));
  if (calibration.source.units) facts.push(TEXT.inUnits(calibration.source.units));
  return facts.join(" · ");
}

export function calibrationPart({ sending, stored, away, choose, readFile, isLocked }) {
  const ready = usable(stored ?? []);
  const { rig } = sending;
  const chosen = sending.capture.calibration;
  const choice = (label, pairs, value, pick) => selectField(label, pairs, { chosen: value, choose: (text) => pick(text || null), isOff: isLocked, style: "unit" });
  // The list may be older than the chosen calibration.
  const listed = rig.id && !ready.some(({ id }) => id === rig.id) ? [chosen ?? { id: rig.id, name: rig.name ?? "…" }, ...ready] : ready;
  // Keypoints that are played live have no videos from which to calibrate, and no draft.
  const { calibrateFrom = null, stature, board } = sending.draft ?? {};
  const pick = ({ target: { value } }) => {
    const isMade = value in TEXT.from;
    sending.assignDraft?.({ calibrateFrom: isMade ? value : null });
    choose(isMade ? null : value, listed.find(({ id }) => id === value)?.name);
  };
  return html`
    <div class="calibration-choice">
      <select aria-label=${TEXT.stored} ?disabled=${isLocked} @change=${pick}>
        <option value="" .selected=${live(!rig.id && !calibrateFrom)}>${stored === null ? COMMON.loading : listed.length ? COMMON.choose : TEXT.noneStored}</option>
        ${listed.map((calibration) => html`<option value=${calibration.id} .selected=${live(calibration.id === rig.id)}>${dated(calibration)}</option>`)}
        ${sending.draft ? html`<optgroup label=${TEXT.missing}>${Object.entries(TEXT.from).map(([from, label]) => html`<option value=${from} .selected=${live(from === calibrateFrom)}>${label}</option>`)}</optgroup>` : nothing}
      </select>
      <label class="button">${TEXT.file}<input class="unseen" type="file" accept=${ACCEPTED_CALIBRATIONS} ?disabled=${isLocked}
        @change=${(event) => { if (event.target.files.length) readFile(event.target.files[0]); event.target.value = ""; }}></label>
    </div>
    ${calibrateFrom === "people" ? html`${statureField({ value: stature, isOff: isLocked, hintId: "calibrate-hint", change: (text) => sending.assignDraft({ stature: text }) })}` : nothing}
    ${calibrateFrom === "board" ? boardFields(board, (facts) => sending.assignDraft({ board: { ...board, ...facts } })) : nothing}
    ${calibrateFrom ? html`<p class="quiet" id="calibrate-hint">${TEXT.fromHint[calibrateFrom]}</p>` : nothing}
    ${problemBox(away && { message: TEXT.away(away.message) })}
    ${rig.isReading ? html`<p class="chosen" role="status"><b>${rig.name ?? ""}</b> <span class="quiet">${TEXT.checking}</span></p>` : nothing}
    ${chosen ? html`<p class="chosen"><b>${chosen.name}</b> <span class="quiet">${calibrationFacts(chosen)}</span></p>
      ${warningList(chosen.warnings, TEXT.warnings)}` : nothing}
    ${rig.file ? html`<details ?open=${rig.problem !== null || rig.units !== null || rig.up !== null}><summary>${TEXT.unitAndUp}</summary><div class="pair">
      ${choice(TEXT.unit, TEXT.units, rig.units, (units) => readFile(rig.file, units, rig.up))}
      ${choice(TEXT.up, AXES, rig.up, (up) => readFile(rig.file, rig.units, up))}</div></details>` : nothing}`;
}

// Calibration files as stored calibrations: a file whose content is stored already is not sent again.

const KNOWN_KEY = "multicap.calibrations";
const MOST_KNOWN = 50;

function knownCalibrations() {
  try {
    return JSON.parse(localStorage.getItem(KNOWN_KEY)) ?? {};
  } catch {
    return {};
  }
}

function remember(name, id) {
  const entries = Object.entries({ ...knownCalibrations(), [name]: id }).slice(-MOST_KNOWN);
  try {
    localStorage.setItem(KNOWN_KEY, JSON.stringify(Object.fromEntries(entries)));
  } catch { /* storage is off or full: the file is sent again next time */ }
}

// Digest of 53 bits (cyrb53) that tells a user's own files apart. Browsers offer SHA-256 only where pages come encrypted.
function digest(bytes) {
  let [high, low] = [0xdeadbeef, 0x41c6ce57];
  for (const byte of bytes) {
    high = Math.imul(high ^ byte, 2654435761);
    low = Math.imul(low ^ byte, 1597334677);
  }
  high = Math.imul(high ^ (high >>> 16), 2246822507) ^ Math.imul(low ^ (low >>> 13), 3266489909);
  low = Math.imul(low ^ (low >>> 16), 2246822507) ^ Math.imul(high ^ (high >>> 13), 3266489909);
  return (4294967296 * (2097151 & low) + (high >>> 0)).toString(36);
}

// A calibration that was deleted since is sent again.
function unlessAway(problem) {
  if (problem.isAway) throw problem;
  return null;
}

// Stored calibration of a file, which the service checks.
async function storedCalibration(file, units, up) {
  const name = [digest(new Uint8Array(await file.arrayBuffer())), file.size, file.name.split(".").pop(), units, ...(up ? [up] : [])].join("|");
  const id = knownCalibrations()[name];
  const earlier = id ? await call(`/v1/calibrations/${id}`).catch(unlessAway) : null;
  if (earlier?.state === "ready") return earlier;
  const form = new FormData();
  form.append("spec", jsonPart({ method: "file", name: stem(file.name), units, ...(up && { up }) }));
  form.append("calibration", file, file.name); // a file of a chosen folder would have its path as its name
  const calibration = await call("/v1/calibrations", { method: "POST", form });
  remember(name, calibration.id);
  return calibration;
}

// The calibration of the capture. One that is being read takes the place of the one before at once, so that neither the page
// nor a request speaks of the former one.

const NO_CALIBRATION = { id: null, name: null, file: null, units: null, up: null, record: null, problem: null, isReading: false };

export class ChosenCalibration {
  #number = 0; // of the last choice, so that a slow answer does not take the place of a later one

  // `changed` is called after each change.
  constructor(changed) {
    Object.assign(this, NO_CALIBRATION, { changed });
  }

  // Choose a stored calibration; null: none.
  choose(id, name = null) {
    if (id) return this.#read({ id, name }, () => call(`/v1/calibrations/${encodeURIComponent(id)}`));
    this.#number += 1;
    Object.assign(this, NO_CALIBRATION);
    this.changed();
    return Promise.resolve();
  }

  // Store a calibration file, which checks it; the capture names it by its id.
  readFile(file, units = null, up = null) {
    return this.#read({ name: file.name, file, units, up }, () => storedCalibration(file, units, up));
  }

  async #read(wanted, read) {
    const number = ++this.#number;
    Object.assign(this, NO_CALIBRATION, wanted, { isReading: true });
    this.changed();
    let result;
    try {
      const isOver = () => number !== this.#number;
      const record = await persistently(read, { isOver, away: (problem) => { this.problem = problem; this.changed(); } });
      result = { record, id: record.id, name: record.name, problem: null };
    } catch (problem) {
      result = { problem, ...(problem.status === 404 && { id: null }) };
    }
    if (number !== this.#number) return;
    Object.assign(this, result, { isReading: false });
    this.changed();
  }
}
