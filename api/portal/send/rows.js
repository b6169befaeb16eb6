// Table of a capture's files: the camera of each, its timing, and how much of it is sent.

import { percent, size, stem } from "../shared/format.js";
import { helpLink, html, live, moreLink, nothing, problemBox, prose, repeat, typed } from "../shared/lit.js";
import { COMMON, COUNTS } from "../shared/strings/common.js";
import { SEND } from "../shared/strings/send.js";
import { isLaboratory } from "./files.js";

function rowState(row) {
  const share = percent(row.sent / row.size);
  if (row.isSent) return SEND.states.sent;
  if (row.hasFailed && !row.isActive) return SEND.states.failed;
  if (row.file === null) return row.sent ? SEND.sentAgain(share) : SEND.states.again;
  if (row.isActive) return share;
  return row.sent ? SEND.sentShare(share) : "";
}

const enteredNumber = (event, empty) => (event.target.value === "" ? empty : event.target.valueAsNumber);

function timing(row, name, { label, empty, change, isLocked }) {
  return html`<input type="number" class="number" step="any" aria-label=${SEND.ofFile(label, row.name)} placeholder=${empty}
    .value=${typed(row[name] || null)} ?disabled=${isLocked || !row.isUsed}
    @input=${(event) => change(row, { [name]: enteredNumber(event, name === "rate" ? null : 0) })}>`;
}

function cameraField(row, sending, change, isLocked) {
  if (row.kind === "timestamps") return html`<span class="quiet">${SEND.timestamps}</span>`;
  if (row.kind === "ownPoints") return html`<span class="quiet">${SEND.ownPoints}</span>`;
  if (row.kind === "points") return html`<span class="quiet">${isLaboratory(row, sending.rows) ? SEND.laboratory : SEND.points}</span>`;
  if (row.kind === "array") return html`<span class="quiet">${SEND.allCameras}</span>`;
  if (sending.draft.calibrateFrom) return html`<span class="quiet">${stem(row.name)}</span>`;
  const names = sending.cameraNames;
  if (names.length === 0) return html`<span class="quiet">${SEND.afterCalibration}</span>`;
  return html`<select aria-label=${SEND.cameraOf(row.name)} ?disabled=${isLocked || !row.isUsed}
    @change=${(event) => change(row, { camera: event.target.value || null })}>
    <option value="" .selected=${live(row.camera === null)}>${COMMON.choose}</option>
    ${names.map((name) => html`<option value=${name} .selected=${live(name === row.camera)}>${name}</option>`)}
  </select>`;
}

// A recording has one start and one rate, whatever number of files it is in.
function timingCells(row, sending, change, isLocked) {
  const part = sending.findPart(row);
  if (part) return html`<td colspan="2" class="quiet">${SEND.part(part + 1)}</td>`;
  return html`<td>${timing(row, "offset_s", { label: SEND.offset, empty: "0", change, isLocked })}</td>
    <td>${timing(row, "rate", { label: SEND.rateOf, empty: SEND.asIs, change, isLocked })}</td>`;
}

export function fileTable({ sending, change, remove }) {
  const { isLocked } = sending;
  const { table } = SEND;
  const hasVideos = sending.rows.some(({ kind }) => kind === "video");
  return html`<div class="scroll" role="group" aria-label=${SEND.files} tabindex="0"><table class="files">
    <caption class="unseen">${SEND.filesOfCapture}</caption>
    <thead><tr>
      <th scope="col">${table.use}</th><th scope="col">${table.file}</th><th scope="col">${table.camera}</th>
      ${hasVideos ? html`<th scope="col">${table.offset}</th><th scope="col">${table.rate}</th>` : nothing}
      <th scope="col">${table.sent}</th><th scope="col"><span class="unseen">${table.remove}</span></th>
    </tr></thead>
    <tbody>${repeat(sending.rows, (row) => row.name, (row) => html`
      <tr class=${row.isUsed ? "" : "unused"}>
        <td><input type="checkbox" aria-label=${SEND.useFile(row.name)} .checked=${live(row.isUsed)} ?disabled=${isLocked}
          @change=${(event) => change(row, { isUsed: event.target.checked })}></td>
        <td class="file"><div>
          ${sending.findCamera(row)?.thumbnails?.length ? cameraPicture(sending.findCamera(row)) : row.preview ? html`<video class="thumb" src="${row.preview}#t=0.1" preload="metadata" muted playsinline aria-hidden="true" tabindex="-1"></video>` : nothing}
          <span><b>${row.name}</b><br><span class="quiet">${size(row.size)}</span></span>
        </div></td>
        <td>${cameraField(row, sending, change, isLocked)}</td>
        ${hasVideos ? timingCells(row, sending, change, isLocked) : nothing}
        <td class="sent">
          ${row.sent || row.isActive ? html`<progress max="1" .value=${row.size ? row.sent / row.size : 1} aria-label=${SEND.sentOf(row.name)}></progress>` : nothing}
          <span class="quiet">${rowState(row)}</span>
        </td>
        <td><button type="button" class="button ghost icon" aria-label=${SEND.removeFile(row.name)} title=${table.remove} ?disabled=${isLocked}
          @click=${(event) => remove(row, event.target)}>✕</button></td>
      </tr>
      ${findingList(sending.rowFindings(row), sending.session?.preflight.cameras, (list) => html`<tr class="of-camera"><td></td><td colspan="6">${list}</td></tr>`)}
    `)}</tbody>
  </table></div>`;
}

// Part of the view Send that sends: what is sent, how far it is, what the check found, and the buttons.

function summary(sending) {
  const { files, calibration } = sending.capture;
  if (files.length === 0) return html`<p class="quiet">${SEND.noFiles}</p>`;
  const total = files.reduce((sum, row) => sum + row.size, 0);
  const estimate = sending.estimate();
  return html`<p class="quiet">${SEND.summary(COUNTS.files(files.length), size(total), calibration?.name)}</p>
    ${estimate ? html`<p class="quiet">${SEND.estimate(estimate.text, estimate.source)}</p>` : nothing}`;
}

function progressPart(sending) {
  const [sent, total] = sending.used.reduce(([a, b], row) => [a + row.sent, b + row.size], [0, 0]);
  const { phases } = SEND;
  const text = {
    waiting: phases.waiting(sending.unread.join(", ")), sending: phases.sending(size(sent), size(total)), paused: phases.paused(percent(sending.fraction)),
    restoring: phases.restoring, calibrating: phases.calibrating(percent(sending.calibrated)), checking: phases.checking, starting: phases.starting,
  }[sending.phase];
  if (!text) return nothing;
  return html`<div class="upload"><progress max="1" .value=${sending.phase === "calibrating" ? sending.calibrated : sending.fraction} aria-label=${SEND.upload}></progress><p class="quiet" role="status">${text}</p></div>`;
}

function buttons({ sending, numTakes, send, failed, change }) {
  if (sending.phase === "checked") {
    return html`<button type="button" class="button primary" @click=${() => sending.start()}>${SEND.reconstruct}</button>
      <button type="button" class="button" title=${SEND.changeHint} @click=${() => sending.reopen().then(change, failed)}>${SEND.change}</button>
      <button type="button" class="button" @click=${() => sending.discardSession().catch(failed)}>${SEND.discard}</button>`;
  }
  if (sending.phase === "paused") return html`<button type="submit" class="button primary">${SEND.resume}</button>`;
  return html`<button type="submit" class="button primary" aria-disabled=${sending.isBusy ? "true" : nothing}>${numTakes > 1 ? SEND.sendCaptures(numTakes) : SEND.sendAll}</button>
    ${["waiting", "sending"].includes(sending.phase) ? html`<button type="button" class="button" @click=${() => sending.pause()}>${SEND.pause}</button>` : numTakes ? nothing
    : html`<button type="button" class="button" aria-disabled=${sending.isBusy ? "true" : nothing} @click=${() => send({ isCheckOnly: true })}>${SEND.checkOnly}</button>`}`;
}

function checkPart(sending) {
  if (sending.session === null) return nothing;
  const { cameras, findings } = sending.session.preflight;
  const general = findings.filter(({ camera }) => !sending.rows.some((row) => row.camera === camera && camera));
  return html`<div class="checked"><div class="with-help"><h2>${SEND.check}</h2>${helpLink("quality", SEND.check)}</div>
    ${findings.length === 0 ? html`<p>${SEND.checkFine}</p>` : nothing}
    ${findings.length > 0 && general.length === 0 ? html`<p>${SEND.checkBeside}</p>` : nothing}
    ${findingList(general, cameras)}</div>`;
}

// `numTakes` is the number of takes that wait. `send(options)` sends, `failed(problem)` hears of what could not be done,
// `change()` of files that are to be changed.
export function goPanel({ sending, numTakes, send, failed, change }) {
  const { rig } = sending;
  return html`<section class="panel go" aria-label=${SEND.send}>
    <div class="notes">
      ${checkPart(sending)}
      ${rig.problem ? problemBox({ ...rig.problem, code: rig.problem.code, message: SEND.namedProblem(rig.name ?? SEND.calibrationNoun, rig.problem.message) }) : nothing}
      ${problemBox(sending.problem)}
    </div>
    ${progressPart(sending)}
    ${summary(sending)}
    <div class="actions">${buttons({ sending, numTakes, send, failed, change })}</div>
  </section>`;
}

// Findings of the check of a capture's files.

const TONES = { error: "bad", warning: "warn", info: "note" };
// Findings that tell of the load of the service rather than of the files.
const OF_LOAD = ["pictures_left_out"];

// Picture in the middle of a camera's time; nothing for keypoints.
export function cameraPicture(camera) {
  const { thumbnails = [] } = camera ?? {};
  if (thumbnails.length === 0) return nothing;
  return html`<img class="thumb" src=${thumbnails[Math.floor(thumbnails.length / 2)].url} alt="" loading="lazy">`;
}

// Pictures that a finding names, with their cameras and times; beside a copy the camera that it repeats.
function describeEvidence({ code, camera, evidence }, cameras) {
  const names = code === "same_video" ? [camera, evidence?.other_camera] : [camera];
  const shown = names.flatMap((name) => {
    const { thumbnails = [] } = cameras.find((camera) => camera.name === name) ?? {};
    return (evidence?.pictures ?? []).map((number) => ({ name, ...thumbnails[number] })).filter(({ url }) => url);
  });
  if (shown.length === 0) return nothing;
  return html`<div class="pictures">${shown.map(({ name, url, time_s: time }) => html`<figure>
    <img class="evidence" src=${url} alt=${SEND.pictureOf(name, time.toFixed(1))} loading="lazy"><figcaption>${SEND.pictureCaption(name, time.toFixed(1))}</figcaption>
  </figure>`)}</div>`;
}

// `wrap` puts the list where it belongs; nothing without findings. `cameras` come from the check, with their pictures.
export function findingList(findings, cameras = [], wrap = (list) => list) {
  if (findings.length === 0) return nothing;
  return wrap(html`<ul class="findings">${findings.map((finding) => html`<li data-tone=${TONES[finding.severity] ?? "note"}>
    <b>${OF_LOAD.includes(finding.code) ? SEND.serviceBusy : SEND.severities[finding.severity]}</b>
    <div><p>${prose(finding.message)}${finding.hint ? html` <span class="hint">${prose(finding.hint)}</span>` : nothing}${moreLink(finding.code)}</p>${describeEvidence(finding, cameras)}</div>
  </li>`)}</ul>`);
}
