// View Send: a new capture, from dropped files to its job.

import { call } from "../shared/api.js";
import { feed } from "../shared/feed.js";
import { count, percent, size } from "../shared/format.js";
import { html, live, nothing, render, typed } from "../shared/lit.js";
import { readOptions } from "../shared/options.js";
import { problemBox, warningList } from "../shared/problem.js";
import { calibrationPart } from "./calibration.js";
import { choicesForm } from "./choices.js";
import { ACCEPTED, droppedFiles } from "./files.js";
import { findingList } from "./findings.js";
import { recentJobs } from "./recent.js";
import { fileTable } from "./rows.js";
import { sampleButton } from "./sample.js";
import { sending } from "./sending.js";

const MOST_CALIBRATIONS = 100;
const CLOCKS = [
  ["declared", "together, but for their offsets"], ["timecode", "at their timecodes"], ["creation_time", "at their times of creation"],
];

export function open(place) {
  let options = null;
  let stored = [];
  let isOver = false; // whether files are held over the page
  const draw = () => render(page(), place);
  const failed = (problem) => { sending.problem = problem; draw(); };

  const load = async () => {
    options = await readOptions();
    draw();
    stored = (await call(`/v1/calibrations?limit=${MOST_CALIBRATIONS}`)).calibrations;
    draw();
  };

  const change = (row, facts) => sending.assign(row, facts);
  const remove = (row, button) => {
    const buttons = [...place.querySelectorAll("[aria-label^='Remove ']")];
    const next = buttons[buttons.indexOf(button) + 1] ?? buttons[buttons.indexOf(button) - 1];
    sending.removeRow(row);
    draw();
    (next?.isConnected ? next : place.querySelector("#choose-files")).focus();
  };
  const spec = (name, value) => {
    if (value === undefined) delete sending.draft.spec[name]; else sending.draft.spec[name] = value;
    sending.changed();
  };
  const add = (files) => sending.add([...files]).catch(failed);
  const chosen = (event) => {
    const files = [...event.target.files];
    event.target.value = "";
    add(files);
  };

  function dropPart(isLocked) {
    const isEmpty = sending.rows.length === 0;
    return html`<div class="drop ${isOver ? "over" : ""} ${isEmpty ? "" : "small"}">
      ${isEmpty ? html`<p class="lead">Drop the videos of all cameras here, with their calibration, or a whole folder.</p>` : nothing}
      <div class="actions">
        <label class="button">Choose files<input id="choose-files" class="unseen" type="file" multiple accept=${ACCEPTED} ?disabled=${isLocked} @change=${chosen}></label>
        <label class="button">Choose a folder<input class="unseen" type="file" webkitdirectory ?disabled=${isLocked} @change=${chosen}></label>
        ${isEmpty ? sampleButton({ sending, draw, failed }) : html`<button type="button" class="button ghost" ?disabled=${isLocked} @click=${() => { sending.clear(); place.querySelector("#choose-files").focus(); }}>Remove all</button>`}
      </div>
      ${isEmpty ? html`<p class="quiet">One file a camera. A zip of images or of 2D keypoints does instead of a video.</p>` : nothing}
    </div>`;
  }

  function filesPart(isLocked) {
    const isMissing = sending.phase === "draft" && sending.missing.length > 0;
    return html`<section class="panel" aria-labelledby="files-title">
      <h2 id="files-title">Videos</h2>
      ${isMissing ? html`<p class="notice" role="status">${sending.draft.wasSending
    ? `The upload was interrupted at ${percent(sending.fraction)}. Choose the same files again: it goes on where it stopped.`
    : "The page was loaded anew, and browsers keep no files. Choose the same files again."}</p>` : nothing}
      ${dropPart(isLocked)}
      ${sending.notes.map((note) => html`<p class="notice" role="status">${note}</p>`)}
      ${sending.rows.length ? fileTable({ sending, change, remove }) : nothing}
      ${sending.rows.some(({ kind }) => kind === "video") ? html`<label class="field clock"><span>The videos start</span>
        <select ?disabled=${isLocked} @change=${(event) => { sending.draft.clock = event.target.value; sending.changed(); }}>
          ${CLOCKS.map(([clock, label]) => html`<option value=${clock} .selected=${live(clock === sending.draft.clock)}>${label}</option>`)}</select></label>` : nothing}
      ${sending.rows.length && sending.isGuessed ? html`<p class="notice">No file has the name of a camera. Files and cameras are paired in the order of their names: check them.</p>` : nothing}
    </section>`;
  }

  function summary() {
    const used = sending.used;
    const total = used.reduce((sum, row) => sum + row.size, 0);
    if (used.length === 0) return html`<p class="quiet">No files yet.</p>`;
    return html`<p class="quiet">${count(used.length, "file")}, ${size(total)}${sending.calibration ? ` · ${sending.calibration.name}` : ""}</p>`;
  }

  function progressPart() {
    if (!["sending", "paused", "checking", "starting"].includes(sending.phase)) return nothing;
    const [sent, total] = sending.used.reduce(([a, b], row) => [a + row.sent, b + row.size], [0, 0]);
    const text = { sending: `${size(sent)} of ${size(total)} sent`, paused: `Paused at ${percent(sending.fraction)}`,
      checking: "Sent. Checking the files …", starting: "Starting the job …" }[sending.phase];
    return html`<div class="upload"><progress max="1" .value=${sending.fraction} aria-label="Upload"></progress><p class="quiet">${text}</p></div>`;
  }

  function buttons() {
    if (sending.phase === "checked") {
      return html`<button type="button" class="button primary" @click=${() => sending.start()}>Reconstruct</button>
        <button type="button" class="button" @click=${() => sending.discardSession().catch(failed)}>Discard the capture</button>`;
    }
    if (sending.phase === "paused") return html`<button type="submit" class="button primary">Go on</button>`;
    return html`<button type="submit" class="button primary" aria-disabled=${sending.isBusy ? "true" : nothing}>Send and reconstruct</button>
      ${sending.phase === "sending" ? html`<button type="button" class="button" @click=${() => sending.pause()}>Pause</button>`
        : html`<button type="button" class="button" aria-disabled=${sending.isBusy ? "true" : nothing} @click=${() => sending.send({ isCheckOnly: true })}>Send and check only</button>`}`;
  }

  function checkPart() {
    if (sending.session === null) return nothing;
    const { preflight } = sending.session;
    const general = (preflight.findings ?? []).filter(({ camera }) => !sending.rows.some((row) => row.camera === camera && camera));
    const known = new Set((preflight.findings ?? []).map(({ message }) => message));
    const isFine = preflight.warnings.length === 0 && !preflight.findings?.length;
    return html`<div class="checked"><h3>The check</h3>
      ${isFine ? html`<p>Nothing speaks against a reconstruction.</p>` : nothing}
      ${preflight.findings?.length && general.length === 0 ? html`<p>See the findings beside the files.</p>` : nothing}
      ${findingList(general, preflight.cameras)}${warningList(preflight.warnings.filter((warning) => !known.has(warning)))}</div>`;
  }

  function page() {
    const isLocked = ["checking", "checked", "starting"].includes(sending.phase);
    return html`<form class="send" novalidate @submit=${(event) => { event.preventDefault(); sending.send(); }}
        @dragover=${(event) => { event.preventDefault(); if (!isOver) { isOver = true; draw(); } }}
        @dragleave=${(event) => { if (!place.contains(event.relatedTarget)) { isOver = false; draw(); } }}
        @drop=${async (event) => { event.preventDefault(); isOver = false; draw(); if (!isLocked) add(await droppedFiles(event.dataTransfer)); }}>
      <h1 class="title">New capture</h1>
      <div class="steps">
        ${filesPart(isLocked)}
        <section class="panel" aria-labelledby="calibration-title"><h2 id="calibration-title">Calibration</h2>
          ${calibrationPart({ sending, stored, isLocked, choose: (id) => sending.chooseCalibration(id).catch(failed), sendFile: (file, units) => sending.sendCalibration(file, units) })}
        </section>
        <section class="panel" aria-labelledby="choices-title"><h2 id="choices-title">Choices</h2>
          ${choicesForm({ id: "send", options, spec: sending.draft.spec, onChange: spec })}
        </section>
      </div>
      <aside class="side">
        <section class="panel go" aria-label="Send">
          <label class="field"><span>Name of the take</span>
            <input name="name" maxlength="200" placeholder="Handshake, take 3" autocomplete="off" .value=${typed(sending.draft.name)}
              ?disabled=${isLocked} @input=${(event) => { sending.draft.name = event.target.value; sending.changed(); }}></label>
          ${summary()}
          ${progressPart()}
          ${checkPart()}
          <div class="actions">${buttons()}</div>
          ${problemBox(sending.problem)}
        </section>
        ${recentJobs(feed, sending.lastJob)}
      </aside>
    </form>`;
  }

  sending.addEventListener("change", draw);
  feed.addEventListener("change", draw);
  draw();
  load().catch(failed);
  return {
    title: "New capture",
    close() {
      sending.removeEventListener("change", draw);
      feed.removeEventListener("change", draw);
    },
  };
}
