// Part of the view Send that sends: what is sent, how far it is, what the check found, and the buttons.

import { count, percent, size } from "../shared/format.js";
import { html, nothing } from "../shared/lit.js";
import { problemBox, warningList } from "../shared/problem.js";
import { findingList } from "./findings.js";

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
  const { preflight } = sending.session;
  const general = (preflight.findings ?? []).filter(({ camera }) => !sending.rows.some((row) => row.camera === camera && camera));
  const known = new Set((preflight.findings ?? []).map(({ message }) => message));
  const isFine = preflight.warnings.length === 0 && !preflight.findings?.length;
  return html`<div class="checked"><h2>The check</h2>
    ${isFine ? html`<p>Nothing speaks against a reconstruction.</p>` : nothing}
    ${preflight.findings?.length && general.length === 0 ? html`<p>See the findings beside the files.</p>` : nothing}
    ${findingList(general, preflight.cameras)}${warningList(preflight.warnings.filter((warning) => !known.has(warning)))}</div>`;
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
