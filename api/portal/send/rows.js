// Table of a capture's files: the camera of each, its timing, and how much of it is sent.

import { percent, size } from "../shared/format.js";
import { html, live, nothing, repeat, typed } from "../shared/lit.js";
import { findingList, pictureOf } from "./findings.js";

function stateOf(row) {
  if (row.isSent) return "sent";
  if (row.hasFailed && !row.isActive) return "failed";
  if (row.file === null) return row.sent ? `${percent(row.sent / row.size)} sent; choose the file again` : "choose the file again";
  if (row.isActive) return percent(row.sent / row.size);
  return row.sent ? `${percent(row.sent / row.size)} sent` : "";
}

const numberOf = (event, empty) => (event.target.value === "" ? empty : event.target.valueAsNumber);

function timing(row, name, { label, empty, change, isLocked }) {
  return html`<input type="number" class="number" step="any" aria-label="${label} of ${row.name}" placeholder=${empty}
    .value=${typed(row[name] || null)} ?disabled=${isLocked || !row.isUsed}
    @input=${(event) => change(row, { [name]: numberOf(event, name === "rate" ? null : 0) })}>`;
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
  const part = sending.partOf(row);
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
          ${sending.cameraOf(row)?.thumbnails?.length ? pictureOf(sending.cameraOf(row)) : row.preview ? html`<video class="thumb" src="${row.preview}#t=0.1" preload="metadata" muted playsinline aria-hidden="true" tabindex="-1"></video>` : nothing}
          <span><b>${row.name}</b><br><span class="quiet">${size(row.size)}</span></span>
        </div></td>
        <td>${cameraField(row, sending, change, isLocked)}</td>
        ${hasVideos ? timingCells(row, sending, change, isLocked) : nothing}
        <td class="sent">
          ${row.sent || row.isActive ? html`<progress max="1" .value=${row.size ? row.sent / row.size : 1} aria-label="Sent of ${row.name}"></progress>` : nothing}
          <span class="quiet">${stateOf(row)}</span>
        </td>
        <td><button type="button" class="button ghost icon" aria-label="Remove ${row.name}" title="Remove" ?disabled=${isLocked}
          @click=${(event) => remove(row, event.target)}>✕</button></td>
      </tr>
      ${findingList(sending.findingsOf(row), sending.session?.preflight.cameras, (list) => html`<tr class="of-camera"><td></td><td colspan="6">${list}</td></tr>`)}
    `)}</tbody>
  </table></div>`;
}
