// Table of a capture's files: the camera of each, its timing, and how much of it is sent.

import { count, percent, size } from "../shared/format.js";
import { html, live, nothing, problemBox, repeat, typed } from "../shared/lit.js";

function rowState(row) {
  if (row.isSent) return "sent";
  if (row.hasFailed && !row.isActive) return "failed";
  if (row.file === null) return row.sent ? `${percent(row.sent / row.size)} sent; choose the file again` : "choose the file again";
  if (row.isActive) return percent(row.sent / row.size);
  return row.sent ? `${percent(row.sent / row.size)} sent` : "";
}

const enteredNumber = (event, empty) => (event.target.value === "" ? empty : event.target.valueAsNumber);

function timing(row, name, { label, empty, change, isLocked }) {
  return html`<input type="number" class="number" step="any" aria-label="${label} of ${row.name}" placeholder=${empty}
    .value=${typed(row[name] || null)} ?disabled=${isLocked || !row.isUsed}
    @input=${(event) => change(row, { [name]: enteredNumber(event, name === "rate" ? null : 0) })}>`;
}

function cameraField(row, sending, change, isLocked) {
  if (row.kind === "timestamps") return html`<span class="quiet">timestamps</span>`;
  if (row.kind === "array") return html`<span class="quiet">all cameras, in the order of their names</span>`;
  const names = sending.cameraNames;
  if (names.length === 0) return html`<span class="quiet">after the calibration</span>`;
  return html`<select aria-label="Camera of ${row.name}" ?disabled=${isLocked || !row.isUsed}
    @change=${(event) => change(row, { camera: event.target.value || null })}>
    <option value="" .selected=${live(row.camera === null)}>Choose …</option>
    ${names.map((name) => html`<option value=${name} .selected=${live(name === row.camera)}>${name}</option>`)}
  </select>`;
}

// A recording has one start and one rate, whatever number of files it is in.
function timingCells(row, sending, change, isLocked) {
  const part = sending.findPart(row);
  if (part) return html`<td colspan="2" class="quiet">part ${part + 1} of the recording</td>`;
  return html`<td>${timing(row, "offset_s", { label: "Offset in seconds", empty: "0", change, isLocked })}</td>
    <td>${timing(row, "rate", { label: "Frame rate in Hz", empty: "as is", change, isLocked })}</td>`;
}

export function fileTable({ sending, change, remove }) {
  const { isLocked } = sending;
  const hasVideos = sending.rows.some(({ kind }) => kind === "video");
  return html`<div class="scroll" role="group" aria-label="Files" tabindex="0"><table class="files">
    <caption class="unseen">Files of the capture</caption>
    <thead><tr>
      <th scope="col">Use</th><th scope="col">File</th><th scope="col">Camera</th>
      ${hasVideos ? html`<th scope="col">Offset, s</th><th scope="col">Rate, Hz</th>` : nothing}
      <th scope="col">Sent</th><th scope="col"><span class="unseen">Remove</span></th>
    </tr></thead>
    <tbody>${repeat(sending.rows, (row) => row.name, (row) => html`
      <tr class=${row.isUsed ? "" : "unused"}>
        <td><input type="checkbox" aria-label="Use ${row.name}" .checked=${live(row.isUsed)} ?disabled=${isLocked}
          @change=${(event) => change(row, { isUsed: event.target.checked })}></td>
        <td class="file"><div>
          ${sending.findCamera(row)?.thumbnails?.length ? cameraPicture(sending.findCamera(row)) : row.preview ? html`<video class="thumb" src="${row.preview}#t=0.1" preload="metadata" muted playsinline aria-hidden="true" tabindex="-1"></video>` : nothing}
          <span><b>${row.name}</b><br><span class="quiet">${size(row.size)}</span></span>
        </div></td>
        <td>${cameraField(row, sending, change, isLocked)}</td>
        ${hasVideos ? timingCells(row, sending, change, isLocked) : nothing}
        <td class="sent">
          ${row.sent || row.isActive ? html`<progress max="1" .value=${row.size ? row.sent / row.size : 1} aria-label="Sent of ${row.name}"></progress>` : nothing}
          <span class="quiet">${rowState(row)}</span>
        </td>
        <td><button type="button" class="button ghost icon" aria-label="Remove ${row.name}" title="Remove" ?disabled=${isLocked}
          @click=${(event) => remove(row, event.target)}>✕</button></td>
      </tr>
      ${findingList(sending.rowFindings(row), sending.session?.preflight.cameras, (list) => html`<tr class="of-camera"><td></td><td colspan="6">${list}</td></tr>`)}
    `)}</tbody>
  </table></div>`;
}

// Part of the view Send that sends: what is sent, how far it is, what the check found, and the buttons.

function summary(sending) {
  const { files, calibration } = sending.capture;
  if (files.length === 0) return html`<p class="quiet">No files yet.</p>`;
  const total = files.reduce((sum, row) => sum + row.size, 0);
  const estimate = sending.estimate();
  return html`<p class="quiet">${count(files.length, "file")}, ${size(total)}${calibration ? ` · ${calibration.name}` : ""}</p>
    ${estimate ? html`<p class="quiet">Takes ${estimate.text}, ${estimate.source}.</p>` : nothing}`;
}

function progressPart(sending) {
  const [sent, total] = sending.used.reduce(([a, b], row) => [a + row.sent, b + row.size], [0, 0]);
  const text = {
    waiting: `Sent as soon as this is read: ${sending.unread.join(", ")}`, sending: `${size(sent)} of ${size(total)} sent`,
    paused: `Paused at ${percent(sending.fraction)}`, restoring: "Looking for the capture that was sent …",
    checking: "Sent. Checking the files …", starting: "Starting the job …",
  }[sending.phase];
  if (!text) return nothing;
  return html`<div class="upload"><progress max="1" .value=${sending.fraction} aria-label="Upload"></progress><p class="quiet" role="status">${text}</p></div>`;
}

function buttons({ sending, numTakes, send, failed, change }) {
  if (sending.phase === "checked") {
    return html`<button type="button" class="button primary" @click=${() => sending.start()}>Reconstruct</button>
      <button type="button" class="button" title="The files are sent again." @click=${() => sending.reopen().then(change, failed)}>Change the files</button>
      <button type="button" class="button" @click=${() => sending.discardSession().catch(failed)}>Discard the capture</button>`;
  }
  if (sending.phase === "paused") return html`<button type="submit" class="button primary">Go on</button>`;
  return html`<button type="submit" class="button primary" aria-disabled=${sending.isBusy ? "true" : nothing}>${numTakes > 1 ? `Send and reconstruct ${numTakes} takes` : "Send and reconstruct"}</button>
    ${["waiting", "sending"].includes(sending.phase) ? html`<button type="button" class="button" @click=${() => sending.pause()}>Pause</button>` : numTakes ? nothing
    : html`<button type="button" class="button" aria-disabled=${sending.isBusy ? "true" : nothing} @click=${() => send({ isCheckOnly: true })}>Send and check only</button>`}`;
}

function checkPart(sending) {
  if (sending.session === null) return nothing;
  const { cameras, findings } = sending.session.preflight;
  const general = findings.filter(({ camera }) => !sending.rows.some((row) => row.camera === camera && camera));
  return html`<div class="checked"><h2>The check</h2>
    ${findings.length === 0 ? html`<p>Nothing speaks against a reconstruction.</p>` : nothing}
    ${findings.length > 0 && general.length === 0 ? html`<p>See the findings beside the files.</p>` : nothing}
    ${findingList(general, cameras)}</div>`;
}

// `numTakes` is the number of takes that wait. `send(options)` sends, `failed(problem)` hears of what could not be done,
// `change()` of files that are to be changed.
export function goPanel({ sending, numTakes, send, failed, change }) {
  const { rig } = sending;
  return html`<section class="panel go" aria-label="Send">
    <div class="notes">
      ${checkPart(sending)}
      ${rig.problem ? problemBox({ ...rig.problem, message: `${rig.name ?? "The calibration"}: ${rig.problem.message}` }) : nothing}
      ${problemBox(sending.problem)}
    </div>
    ${progressPart(sending)}
    ${summary(sending)}
    <div class="actions">${buttons({ sending, numTakes, send, failed, change })}</div>
  </section>`;
}

// Findings of the check of a capture's files.

const TONES = { error: "bad", warning: "warn", info: "note" };
const WORDS = { error: "Error", warning: "Warning", info: "Note" };
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
    <img class="evidence" src=${url} alt="Picture of ${name} at ${time.toFixed(1)} s" loading="lazy"><figcaption>${name}, ${time.toFixed(1)} s</figcaption>
  </figure>`)}</div>`;
}

// `wrap` puts the list where it belongs; nothing without findings. `cameras` come from the check, with their pictures.
export function findingList(findings, cameras = [], wrap = (list) => list) {
  if (findings.length === 0) return nothing;
  return wrap(html`<ul class="findings">${findings.map((finding) => html`<li data-tone=${TONES[finding.severity] ?? "note"}>
    <b>${OF_LOAD.includes(finding.code) ? "The service was busy" : WORDS[finding.severity] ?? "Note"}</b>
    <div><p>${finding.message}${finding.hint ? html` <span class="hint">${finding.hint}</span>` : nothing}</p>${describeEvidence(finding, cameras)}</div>
  </li>`)}</ul>`);
}
