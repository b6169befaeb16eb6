// View Send: a new capture, from dropped files to its job.

import { call, persistently, RequestProblem } from "../shared/api.js";
import { feed } from "../shared/feed.js";
import { percent } from "../shared/format.js";
import { hasEnded, jobState } from "../shared/jobs.js";
import { helpLink, html, live, nothing, problemBox, render, repeat, selectField, typed } from "../shared/lit.js";
import { address, go } from "../shared/page.js";
import { characters, readCalibrations } from "../shared/resources.js";
import { COMMON, COUNTS } from "../shared/strings/common.js";
import { SEND } from "../shared/strings/send.js";
import { calibrationPart } from "./calibration.js";
import { MEASURED, OF_CAMERAS, findDoubled } from "./capture_plan.js";
import { choicesForm } from "./choices.js";
import { ACCEPTED, AXES, droppedFiles } from "./files.js";
import { fileTable, goPanel } from "./rows.js";
import { sending } from "./sending.js";
import { takes } from "./takes.js";

const HIDDEN = ["sync"]; // stands with the start of the videos
const LAYOUTS = [
  "coco-17", "human36m-17", "coco-18", "trt-pose-18", "coco-wholebody-23", "body-25", "body-25b", "halpe-26", "mediapipe-33",
  "coco-wholebody-133", "halpe-136",
];

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
    const items = unread.map((field) => ({ message: SEND.fieldNeedsNumber(field.ariaLabel ?? field.labels[0].innerText.split("\n")[0]) }));
    return failed({ message: SEND.incomplete, items });
  };
  const takesFiles = () => sending.takesFiles && !takes.isRunning;
  const add = (files) => takes.add(files).catch(failed);
  const chosen = (event) => {
    const files = [...event.target.files];
    event.target.value = "";
    add(files);
  };

  // Time of this take with a value of a choice.
  const valueNote = (choice, value) => (choice.name === "profile" ? sending.estimate({ profile: value })?.text : null);

  function dropPart(isLocked) {
    const isEmpty = sending.rows.length === 0;
    return html`<div class="drop ${isOver ? "over" : ""} ${isEmpty ? "" : "small"}">
      ${isEmpty ? html`<p class="lead">${SEND.lead}</p>` : nothing}
      <div class="actions">
        <label class="button">${SEND.chooseFiles}<input id="choose-files" class="unseen" type="file" multiple accept=${ACCEPTED} ?disabled=${isLocked} @change=${chosen}></label>
        <label class="button">${SEND.chooseFolder}<input class="unseen" type="file" webkitdirectory ?disabled=${isLocked} @change=${chosen}></label>
        ${isEmpty ? sampleButton({ sending, draw, failed }) : html`<button type="button" class="button ghost" ?disabled=${isLocked} @click=${() => { takes.clear(); place.querySelector("#choose-files").focus(); }}>${SEND.removeAll}</button>`}
      </div>
      ${isEmpty ? html`<p class="quiet">${SEND.leadHint}</p>` : nothing}
    </div>`;
  }

  // Facts about times that the files do not state.
  function timePart(isLocked) {
    const { start, views, is3d, needsFrameRate, frameRate_hz: rate, hasPoints, layout, units, up, laboratory, laboratoryClock } = sending.capture;
    if (views.length === 0) return nothing;
    const rateField = (label, hint, isRequired) => html`<label class="field clock"><span>${label}</span>
        <input type="number" class="number" min="1" max="1000" step="any" ?required=${isRequired} .value=${typed(rate)} ?disabled=${isLocked}
          @input=${(event) => { sending.draft.frameRate_hz = event.target.value === "" ? null : event.target.valueAsNumber; sending.changed(); }}>
        <span class="quiet">${hint}</span></label>`;
    const select = (label, name, chosen, pairs) => selectField(label, pairs, { chosen, choose: (value) => sending.assignDraft({ [name]: value || null }), isOff: isLocked, style: "clock" });
    if (is3d) {
      const told = [["", SEND.pointsTell]];
      return [
        rateField(SEND.pointsRate, SEND.pointsRateHint, false),
        select(SEND.calibration.unit, "units", units, [...told, ...SEND.calibration.units.slice(1), ...SEND.pointUnits]),
        select(SEND.calibration.up, "up", up, [...told, ["z", "Z"], ...AXES.slice(1)]),
      ];
    }
    const isVideo = views.some(({ kind }) => kind === "video");
    const [kind, label] = isVideo ? ["video", SEND.videosStart] : ["keypoints", SEND.camerasStart];
    const starts = [...SEND.starts[kind], [MEASURED, SEND.startUnknown[kind]]];
    return html`<div class="field clock"><span class="with-help"><label for="start">${label}</label>${helpLink("synchronization", label)}</span>
        <select id="start" ?disabled=${isLocked} @change=${(event) => { sending.draft.clock = event.target.value; sending.changed(); }}>
          ${starts.map(([name, label]) => html`<option value=${name} .selected=${live(name === start)}>${label}</option>`)}</select></div>
      ${needsFrameRate ? rateField(SEND.rate, SEND.rateHint, true) : nothing}
      ${laboratory.length ? select(SEND.laboratoryClock, "laboratoryClock", laboratoryClock, SEND.laboratoryClocks) : nothing}
      ${hasPoints ? select(SEND.layout, "layout", layout, [["", SEND.layoutAuto], ...LAYOUTS.map((name) => [name, name])]) : nothing}`;
  }

  function filesPart(isLocked) {
    const isMissing = sending.phase === "draft" && sending.missing.length > 0;
    return html`<section class="panel" aria-labelledby="files-title">
      <h2 id="files-title">${SEND.videos}</h2>
      ${isMissing ? html`<p class="notice" role="status">${sending.draft.wasSending
    ? SEND.interrupted(percent(sending.fraction)) : SEND.reloaded}</p>` : nothing}
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
    return html`<p class="notice">${SEND.unpaired(listed(unpaired.map(({ name }) => name)))} ${free.length ? SEND.free(listed(free)) : SEND.noneFree}
      ${free.length === unpairedRecordings.length ? html`<button type="button" class="button ghost" ?disabled=${isLocked} @click=${() => sending.pairByOrder()}>${SEND.pair}</button>` : nothing}</p>`;
  }

  // Videos of cameras that have several, which may be the parts of a recording.
  function joining(isLocked) {
    const twice = findDoubled(sending.capture.views).filter(({ kind }) => kind === "video");
    if (twice.length === 0) return nothing;
    return html`<p class="notice">${SEND.twice(twice.map(({ name }) => name).join(", "))}
      <button type="button" class="button ghost" ?disabled=${isLocked} @click=${() => sending.join(twice)}>${SEND.join}</button></p>`;
  }

  function page() {
    const { isLocked } = sending;
    const { is3d, spec: chosenSpec } = sending.capture;
    return html`<form class="send" novalidate @submit=${(event) => { event.preventDefault(); send(); }}
        @dragover=${(event) => { event.preventDefault(); if (!isOver) { isOver = true; draw(); } }}
        @dragleave=${(event) => { if (!place.contains(event.relatedTarget)) { isOver = false; draw(); } }}
        @drop=${(event) => { event.preventDefault(); isOver = false; draw(); if (takesFiles()) add(droppedFiles(event.dataTransfer)); }}>
      <div class="bar"><h1 class="title">${SEND.title}</h1>
        <label class="take"><span>${SEND.name}</span>
          <input name="name" maxlength="200" placeholder=${SEND.namePlaceholder} autocomplete="off" .value=${typed(sending.capture.name)}
            ?disabled=${isLocked} @input=${(event) => { sending.draft.name = event.target.value; sending.changed(); }}></label></div>
      <div class="steps">
        ${takesPanel(takes, failed)}
        ${filesPart(isLocked)}
        ${is3d ? nothing : html`<section class="panel" aria-labelledby="calibration-title"><div class="with-help"><h2 id="calibration-title">${COMMON.calibration}</h2>${helpLink("calibration", COMMON.calibration)}</div>
          ${calibrationPart({ sending, stored, away, isLocked, choose: (id, name) => sending.chooseCalibration(id, name), readFile: (...chosen) => sending.readCalibration(...chosen) })}
        </section>`}
        ${recentJobs(feed)}
      </div>
      <div class="side">
        <section class="panel" aria-label=${SEND.options}>
          ${choicesForm({ id: "send", options: sending.options, spec: chosenSpec, onChange: spec, hidden: is3d ? OF_CAMERAS : HIDDEN, valueNote })}
        </section>
        ${goPanel({ sending, numTakes: takes.waiting.length, send, failed, change: () => place.querySelector("#choose-files").focus() })}
      </div>
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
    title: SEND.title,
    close() {
      isClosed = true;
      sending.removeEventListener("sent", onSent);
      sending.removeEventListener("change", draw);
      feed.removeEventListener("change", draw);
      characters.removeEventListener("change", draw);
    },
  };
}

// Part of the view Send that lists the takes of a folder.

const { folders: FOLDERS } = SEND;
const TAKE_TONES = { sent: "good", before: "good", failed: "bad" };

function takesOffer(takes, failed) {
  const names = takes.offered.takes.map(({ name }) => name);
  return html`<section class="panel" aria-labelledby="takes-title"><h2 id="takes-title">${COUNTS.folders(names.length)}</h2>
    <p>${FOLDERS.offer(names.join(", "))}</p>
    <div class="actions">
      <button type="button" class="button primary" @click=${() => takes.accept().catch(failed)}>${FOLDERS.accept(names.length)}</button>
      <button type="button" class="button" @click=${() => takes.decline().catch(failed)}>${FOLDERS.decline}</button>
    </div></section>`;
}

function takeRow(take, takes, failed) {
  const { name, files, state, problem, job } = take;
  const tools = takes.isRunning ? nothing : html`
    ${state in FOLDERS.again ? html`<button type="button" class="button ghost" aria-label=${FOLDERS.againOf(FOLDERS.again[state], name)} @click=${() => takes.again(take).catch(failed)}>${FOLDERS.again[state]}</button>` : nothing}
    ${state === "sent" ? nothing : html`<button type="button" class="button ghost icon" aria-label=${FOLDERS.leaveOutOf(name)} title=${FOLDERS.leaveOut} @click=${() => takes.remove(take)}>✕</button>`}`;
  return html`<li>
    <b>${job ? html`<a href=${address("jobs", job.id)}>${name}</a>` : name}</b>
    <span class="quiet">${COUNTS.files(files.length)}</span>
    <span class="state" data-tone=${TAKE_TONES[state] ?? nothing}>${FOLDERS.states[state]}</span>
    <span class="tools">${tools}</span>
    ${problemBox(problem)}</li>`;
}

function takesPanel(takes, failed) {
  if (takes.offered) return takesOffer(takes, failed);
  if (takes.list.length === 0) return nothing;
  const numSent = takes.list.filter(({ job }) => job).length;
  return html`<section class="panel" aria-labelledby="takes-title">
    <h2 id="takes-title">${FOLDERS.progress(COUNTS.captures(takes.list.length), numSent)}</h2>
    <p class="quiet">${FOLDERS.hint}</p>
    <ol class="takes" aria-label=${FOLDERS.list}>${repeat(takes.list, ({ name }) => name, (take) => takeRow(take, takes, failed))}</ol></section>`;
}

// The latest jobs in short, beside the form.

const SHOWN_JOBS = 4;

function recentJobs(feed) {
  const jobs = feed.newest().slice(0, SHOWN_JOBS);
  if (jobs.length === 0) return nothing;
  return html`<section class="panel recent" aria-labelledby="recent-title">
    <h2 id="recent-title">${SEND.recent}</h2>
    <ol>${repeat(jobs, ({ id }) => id, (job) => {
      const { words, tone } = jobState(job);
      return html`<li>
        <a href=${address("jobs", job.id)}>${job.kind === "calibration" ? SEND.calibrationJob(job.session_name) : job.session_name}</a>
        <span class="state" data-tone=${tone}>${words}</span>
        ${hasEnded(job) ? nothing : html`<progress max="1" .value=${job.progress} aria-label=${SEND.progressOf(job.session_name)}></progress>`}
      </li>`;
    })}</ol>
    <a class="all" href="#/captures">${SEND.allCaptures}</a>
  </section>`;
}

// One click to try the service: the sample capture, if the machine of the service has it.

let isSampleLoading = false;

async function fetchFile({ name, url, media_type: type }) {
  const response = await fetch(url);
  if (!response.ok) throw new RequestProblem(await response.json().catch(() => null), response.status);
  return new File([await response.blob()], name, { type, lastModified: 0 });
}

async function fetchSample() {
  const sample = await call("/v1/sample");
  if (!sample.installed) {
    throw new RequestProblem({ detail: SEND.sampleMissing, hint: sample.install });
  }
  return { ...sample, files: await Promise.all(sample.files.map(fetchFile)) };
}

// Add the sample to the capture; false if other files were chosen meanwhile.
async function addSample(sending) {
  const { files, attribution } = await fetchSample();
  if (sending.rows.length) return false;
  sending.draft.name ||= SEND.sampleName;
  await sending.add(files);
  sending.notes.push(attribution);
  return true;
}

function sampleButton({ sending, draw, failed }) {
  const load = async () => {
    isSampleLoading = true;
    draw();
    try {
      if (await sending.reading(SEND.unread.sample, addSample(sending))) await sending.send();
    } catch (problem) {
      failed(problem);
    } finally {
      isSampleLoading = false;
      draw();
    }
  };
  return html`<button type="button" class="button ghost" ?disabled=${isSampleLoading} @click=${load}>${isSampleLoading ? SEND.sampleLoading : SEND.sample}</button>`;
}
