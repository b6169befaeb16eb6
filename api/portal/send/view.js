// View Send: a new capture, from dropped files to its job.

import { persistently } from "../shared/away.js";
import { characters } from "../shared/characters.js";
import { feed } from "../shared/feed.js";
import { readCalibrations } from "../shared/calibrations.js";
import { percent } from "../shared/format.js";
import { html, live, nothing, render, typed } from "../shared/lit.js";
import { go } from "../shared/router.js";
import { calibrationPart } from "./calibration.js";
import { MEASURED } from "./capture.js";
import { choicesForm } from "./choices.js";
import { ACCEPTED, droppedFiles } from "./files.js";
import { twiceOf } from "./faults.js";
import { goPanel } from "./go.js";
import { recentJobs } from "./recent.js";
import { fileTable } from "./rows.js";
import { sampleButton } from "./sample.js";
import { sending } from "./sending.js";
import { takes } from "./takes.js";
import { takesPanel } from "./takes_panel.js";

const HIDDEN = ["sync"]; // stands with the start of the videos
const MEASURE = [MEASURED, "I don't know: measure their clocks from people and sound"];
const LAYOUTS = [
  "coco-17", "human36m-17", "coco-18", "trt-pose-18", "coco-wholebody-23", "body-25", "body-25b", "halpe-26", "mediapipe-33",
  "coco-wholebody-133", "halpe-136",
];
const STARTS = {
  video: [["declared", "together, but for their offsets"], ["timecode", "at their timecodes"], ["creation_time", "at their times of creation"], MEASURE],
  keypoints: [["declared", "together, or at their timestamps"], [MEASURED, "I don't know: measure their clocks from people"]],
};

export function open(place) {
  let stored = null; // calibrations, once they are loaded
  let away = null; // why they are not
  let isClosed = false;
  let isOver = false; // whether files are held over the page
  const draw = () => render(page(), place);
  const failed = (problem) => { sending.problem = problem; draw(); };

  const loadCalibrations = async () => {
    const isOver = () => isClosed;
    stored = await persistently(readCalibrations, { isOver, away: (problem) => { away = problem; draw(); } });
    away = null;
    if (!isClosed) draw();
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
  // Text that is no number is empty for a script, though the page shows it.
  const send = (options) => {
    const unread = [...place.querySelectorAll("input[type=number]")].filter(({ validity }) => validity.badInput);
    if (unread.length === 0) return takes.waiting.length ? takes.run().catch(failed) : sending.send(options);
    const items = unread.map((field) => ({ message: `${field.ariaLabel ?? field.labels[0].innerText.split("\n")[0]}: type a number.` }));
    return failed({ message: "The capture is not complete.", items });
  };
  const takesFiles = () => sending.takesFiles && !takes.isRunning;
  const add = (files) => takes.add(files).catch(failed);
  const chosen = (event) => {
    const files = [...event.target.files];
    event.target.value = "";
    add(files);
  };

  // Time of this take with a value of a choice.
  const noteOf = (choice, value) => (choice.name === "profile" ? sending.estimate({ profile: value })?.text : null);

  function dropPart(isLocked) {
    const isEmpty = sending.rows.length === 0;
    return html`<div class="drop ${isOver ? "over" : ""} ${isEmpty ? "" : "small"}">
      ${isEmpty ? html`<p class="lead">Drop the videos of all cameras here, with their calibration, or a whole folder, also one with a folder for each take.</p>` : nothing}
      <div class="actions">
        <label class="button">Choose files<input id="choose-files" class="unseen" type="file" multiple accept=${ACCEPTED} ?disabled=${isLocked} @change=${chosen}></label>
        <label class="button">Choose a folder<input class="unseen" type="file" webkitdirectory ?disabled=${isLocked} @change=${chosen}></label>
        ${isEmpty ? sampleButton({ sending, draw, failed }) : html`<button type="button" class="button ghost" ?disabled=${isLocked} @click=${() => { takes.clear(); place.querySelector("#choose-files").focus(); }}>Remove all</button>`}
      </div>
      ${isEmpty ? html`<p class="quiet">One file a camera. A zip of images or of 2D keypoints does instead of a video.</p>` : nothing}
    </div>`;
  }

  // What the files do not say about their times.
  function timePart(isLocked) {
    const { start, views, needsFrameRate, frameRate_hz: rate, hasPoints, layout } = sending.capture;
    if (views.length === 0) return nothing;
    const isVideo = views.some(({ kind }) => kind === "video");
    return html`<label class="field clock"><span>${isVideo ? "The videos start" : "The cameras start"}</span>
        <select ?disabled=${isLocked} @change=${(event) => { sending.draft.clock = event.target.value; sending.changed(); }}>
          ${STARTS[isVideo ? "video" : "keypoints"].map(([name, label]) => html`<option value=${name} .selected=${live(name === start)}>${label}</option>`)}</select></label>
      ${needsFrameRate ? html`<label class="field clock"><span>Frame rate of the keypoints, Hz</span>
        <input type="number" class="number" min="1" max="1000" step="any" required .value=${typed(rate)} ?disabled=${isLocked}
          @input=${(event) => { sending.draft.frameRate_hz = event.target.value === "" ? null : event.target.valueAsNumber; sending.changed(); }}>
        <span class="quiet">Frames a second of the videos that the keypoints are of. A file of timestamps (CSV) does instead.</span></label>` : nothing}
      ${hasPoints ? html`<label class="field clock"><span>Layout of the keypoints</span>
        <select ?disabled=${isLocked} @change=${(event) => { sending.draft.layout = event.target.value || null; sending.changed(); }}>
          ${[null, ...LAYOUTS].map((name) => html`<option value=${name ?? ""} .selected=${live(name === layout)}>${name ?? "Told by the points"}</option>`)}</select></label>` : nothing}`;
  }

  function filesPart(isLocked) {
    const isMissing = sending.phase === "draft" && sending.missing.length > 0;
    return html`<section class="panel" aria-labelledby="files-title">
      <h2 id="files-title">Videos</h2>
      ${isMissing ? html`<p class="notice" role="status">${sending.draft.wasSending
    ? `The upload was interrupted at ${percent(sending.fraction)}. Choose the same files again: it goes on where it stopped.`
    : "The page was loaded anew, and browsers keep no files. Choose the same files again."}</p>` : nothing}
      ${dropPart(!takesFiles())}
      ${sending.notes.map((note) => html`<p class="notice" role="status">${note}</p>`)}
      ${sending.rows.length ? fileTable({ sending, change, remove }) : nothing}
      ${timePart(isLocked)}
      ${sending.unpaired.length ? pairing(isLocked) : nothing}
      ${joining(isLocked)}
    </section>`;
  }

  // Files and cameras whose names don't match.
  function pairing(isLocked) {
    const { unpaired, unpairedRecordings, freeCameras: free } = sending;
    const listed = (names) => names.join(", ");
    return html`<p class="notice">No camera's name, or more than one, is in the ${unpaired.length === 1 ? "name" : "names"} of ${listed(unpaired.map(({ name }) => name))}. ${free.length ? `Free cameras: ${listed(free)}. Choose the camera of each file.` : "No camera is free."}
      ${free.length === unpairedRecordings.length ? html`<button type="button" class="button ghost" ?disabled=${isLocked} @click=${() => sending.pairByOrder()}>Pair by the order of names</button>` : nothing}</p>`;
  }

  // Videos of cameras that have several, which may be the parts of a recording.
  function joining(isLocked) {
    const twice = twiceOf(sending.capture.views).filter(({ kind }) => kind === "video");
    if (twice.length === 0) return nothing;
    return html`<p class="notice">One camera has two files: ${twice.map(({ name }) => name).join(", ")}.
      <button type="button" class="button ghost" ?disabled=${isLocked} @click=${() => sending.join(twice)}>They are parts of one recording, in the order of their names</button></p>`;
  }

  function page() {
    const { isLocked } = sending;
    return html`<form class="send" novalidate @submit=${(event) => { event.preventDefault(); send(); }}
        @dragover=${(event) => { event.preventDefault(); if (!isOver) { isOver = true; draw(); } }}
        @dragleave=${(event) => { if (!place.contains(event.relatedTarget)) { isOver = false; draw(); } }}
        @drop=${(event) => { event.preventDefault(); isOver = false; draw(); if (takesFiles()) add(droppedFiles(event.dataTransfer)); }}>
      <div class="bar"><h1 class="title">New capture</h1>
        <label class="take"><span>Name of the take</span>
          <input name="name" maxlength="200" placeholder="Handshake, take 3" autocomplete="off" .value=${typed(sending.capture.name)}
            ?disabled=${isLocked} @input=${(event) => { sending.draft.name = event.target.value; sending.changed(); }}></label></div>
      <div class="steps">
        ${takesPanel(takes, failed)}
        ${filesPart(isLocked)}
        <section class="panel" aria-labelledby="calibration-title"><h2 id="calibration-title">Calibration</h2>
          ${calibrationPart({ sending, stored, away, isLocked, choose: (id, name) => sending.chooseCalibration(id, name), readFile: (...chosen) => sending.readCalibration(...chosen) })}
        </section>
        <section class="panel" aria-labelledby="choices-title"><h2 id="choices-title">Choices</h2>
          ${choicesForm({ id: "send", options: sending.options, spec: sending.capture.spec, onChange: spec, hidden: HIDDEN, noteOf })}
        </section>
      </div>
      <aside class="side">${goPanel({ sending, numTakes: takes.waiting.length, send, failed, change: () => place.querySelector("#choose-files").focus() })}${recentJobs(feed)}</aside>
    </form>`;
  }

  const onSent = ({ detail: job }) => { if (takes.list.length === 0) go("jobs", job.id); };
  sending.addEventListener("sent", onSent);
  sending.addEventListener("change", draw);
  feed.addEventListener("change", draw);
  characters.addEventListener("change", draw);
  draw();
  for (const loading of [sending.loadOptions(), loadCalibrations(), characters.load(sending.draft.spec)]) loading.catch((problem) => { if (!isClosed) failed(problem); });
  return {
    title: "New capture",
    close() {
      isClosed = true;
      sending.removeEventListener("sent", onSent);
      sending.removeEventListener("change", draw);
      feed.removeEventListener("change", draw);
      characters.removeEventListener("change", draw);
    },
  };
}
