// Card of a capture: its facts, its cameras, its jobs, and what can be done with it.

import { OF_CAMERAS } from "../send/capture_plan.js";
import { pickCharacter, choicesForm, shownSpec } from "../send/choices.js";
import { findingList, cameraPicture } from "../send/rows.js";
import { sending } from "../send/sending.js";
import { call } from "../shared/api.js";
import { feed } from "../shared/feed.js";
import { length, moment, size } from "../shared/format.js";
import { countCameraFrames, estimateTime, hasEnded } from "../shared/jobs.js";
import { confirm, html, nothing, problemBox, renameForm, repeat, scrollTable, selectField } from "../shared/lit.js";
import { announce } from "../shared/page.js";
import { characters, listed, readCalibrations, usable } from "../shared/resources.js";
import { CAPTURES } from "../shared/strings/captures.js";
import { COMMON, COUNTS } from "../shared/strings/common.js";
import { jobRow } from "./job_row.js";

function fetchFact({ fetches }) {
  const here = fetches.filter(({ state }) => state === "finished");
  if (here.length === fetches.length) return CAPTURES.checking;
  return CAPTURES.fetching(here.length, fetches.length, size(fetches.reduce((sum, { received_bytes: bytes }) => sum + bytes, 0)));
}

function captureFacts(session) {
  if (session.state !== "ready") return [moment(session.created_at), ...(session.state === "fetching" ? [fetchFact(session)] : [])];
  const { cameras, timebase } = session.preflight;
  return [
    moment(session.created_at),
    COUNTS.cameras(cameras.length),
    length(session.duration_s),
    CAPTURES.frames(timebase.num_frames, Number(timebase.frame_rate_hz.toFixed(2))),
    size(session.num_bytes),
    ...(session.videos_deleted_at ? [CAPTURES.videosDeleted] : []),
    ...(session.shows_blurred ? [CAPTURES.facesBlurred] : []),
  ];
}

function thumbnail(camera) {
  if (camera.thumbnails?.length) return cameraPicture(camera);
  if (!camera.video_url) return nothing;
  return html`<video class="thumb" src="${camera.video_url}#t=0.1" preload="metadata" muted playsinline aria-hidden="true" tabindex="-1"></video>`;
}

function cameraTable(view, session) {
  const { cameras, findings } = session.preflight;
  const sizes = new Map(session.files.map(({ name, num_bytes: bytes }) => [name, bytes]));
  // Pictures are loaded once they are seen.
  const isOpen = view.shown.has(session.id);
  const toggle = (event) => {
    if (event.target.open) view.shown.add(session.id); else view.shown.delete(session.id);
    view.draw();
  };
  return html`<details class="cameras" @toggle=${toggle}>
    <summary>${COMMON.cameras}${findings.length ? html` <span class="badge" data-tone="warn">${COUNTS.findings(findings.length)}</span>` : nothing}</summary>
    ${scrollTable(CAPTURES.camerasOf(session.name), CAPTURES.table, cameras.map((camera) => html`<tr><th scope="row"><div class="with-picture">${isOpen ? thumbnail(camera) : nothing}${camera.name}</div></th><td>${camera.file}</td>
        <td>${camera.size_px.join(" × ")}</td><td>${COMMON.hz(Number(camera.frame_rate_hz.toFixed(2)))}</td><td>${camera.num_frames}</td>
        <td>${CAPTURES.startsAt(camera.start_time_s.toFixed(3))}</td><td>${sizes.has(camera.file) ? size(sizes.get(camera.file)) : ""}</td></tr>
        ${findingList(findings.filter((finding) => finding.camera === camera.name), cameras, (list) => html`<tr><td colspan="7">${list}</td></tr>`)}`))}
    ${findingList(findings.filter((finding) => !cameras.some(({ name }) => name === finding.camera)), cameras)}
  </details>`;
}

// Picture of the first camera that has one, so that a capture is known at a glance; nothing of keypoints.
function pictureOfCapture({ name, preflight }) {
  const camera = preflight.cameras.find(({ thumbnails }) => thumbnails?.length);
  if (!camera) return nothing;
  const { url } = camera.thumbnails[Math.floor(camera.thumbnails.length / 2)];
  return html`<img class="cover" src=${url} alt=${CAPTURES.seenBy(name, camera.name)} loading="lazy">`;
}

function nameForm(view, session) {
  const end = () => {
    view.renamed = null;
    view.draw();
    view.place.querySelector(`#rename-${session.id}`)?.focus();
  };
  const rename = (name) => view.act(session.id, async () => {
    const renamed = await call(session.urls.self, { method: "PATCH", body: { name } });
    view.sessions = view.sessions.map((other) => (other.id === session.id ? renamed : other));
    end();
    announce(COMMON.renamed(name));
    await feed.refresh(); // jobs bear the name too
  });
  return renameForm({ name: session.name, rename, end });
}

// True if a capture has 3D points, and no cameras.
const is3d = ({ files }) => files.some(({ kind }) => kind === "points");

export function captureCard(view, session) {
  const jobs = feed.ofSession(session.id);
  const isBusy = jobs.some((job) => !hasEnded(job));
  // A session of a calibration's footage has no calibrated cameras to reconstruct with.
  const isFootage = jobs.length > 0 && jobs.every(({ kind }) => kind === "calibration");

  const remove = async () => {
    const { title, text, action, said } = CAPTURES.deleting;
    const question = { title: title(session.name), text: text(size(session.num_bytes)), action };
    if (!await confirm(question)) return;
    await view.act(session.id, async () => {
      await call(session.urls.self, { method: "DELETE" });
      for (const job of jobs) feed.remove(job.id);
      view.sessions = view.sessions.filter(({ id }) => id !== session.id);
      view.draw();
      announce(said(session.name));
      view.focusList();
    });
  };
  const hasVideos = session.videos_deleted_at === null && session.files.some(({ kind }) => kind === "video");
  const hasResults = jobs.some(({ results_revision: revision }) => revision !== null);
  const removeVideos = async () => {
    const bytes = session.files.reduce((sum, { kind, num_bytes: more }) => sum + (kind === "video" ? more : 0), 0);
    const { title, text, action, said } = CAPTURES.deletingVideos;
    const question = { title: title(session.name), text: text(size(bytes)), action };
    if (!await confirm(question)) return;
    await view.act(session.id, async () => {
      await call(`${session.urls.self}/videos`, { method: "DELETE" });
      const changed = await call(session.urls.self);
      view.sessions = view.sessions.map((other) => (other.id === session.id ? changed : other));
      view.draw();
      announce(said(session.name));
      view.focusList();
    });
  };

  const recalibrate = () => view.act(session.id, async () => {
    if (view.recalibrated.has(session.id)) view.recalibrated.delete(session.id);
    else view.recalibrated.set(session.id, usable(await readCalibrations()));
  });
  const toggleForm = () => {
    if (view.opened.has(session.id)) view.opened.delete(session.id);
    else {
      const last = jobs.length ? {} : shownSpec(sending.draft.spec, view.options); // choices of the capture before
      const spec = { ...last, ...jobSpec(jobs[0], view.options, session) };
      view.opened.set(session.id, spec);
      characters.load(spec);
    }
    view.draw();
    view.place.querySelector(`#again-${session.id} input, #again-${session.id} select`)?.focus();
  };

  const run = jobs.length ? CAPTURES.runAgain : CAPTURES.reconstruct;
  return html`<li class="panel capture" aria-labelledby="name-${session.id}">
    <div class="head">
      ${pictureOfCapture(session)}
      <div>
        ${view.renamed === session.id ? nameForm(view, session) : html`<h2 id="name-${session.id}">${isFootage ? CAPTURES.ofCalibration(session.name) : session.name}</h2>`}
        <p class="quiet facts">${captureFacts(session).map((fact) => html`<span>${fact}</span>`)}</p>
      </div>
      ${view.canWrite ? html`<div class="actions">
        ${isFootage || session.state === "failed" ? nothing : html`<button type="button" class="button small" aria-expanded=${view.opened.has(session.id) ? "true" : "false"}
          ?disabled=${!view.options} id="run-${session.id}" aria-label=${CAPTURES.actionOf(run, session.name)} @click=${toggleForm}>${run}</button>`}
        ${session.state === "ready" && !is3d(session) ? html`<button type="button" class="button small" id="recalibrate-${session.id}" aria-expanded=${view.recalibrated.has(session.id) ? "true" : "false"}
          aria-label=${CAPTURES.actionOf(CAPTURES.recalibrate, session.name)} @click=${recalibrate}>${CAPTURES.recalibrate}</button>` : nothing}
        <button type="button" class="button small" id="rename-${session.id}" aria-label=${COMMON.renameOf(session.name)} @click=${() => { view.renamed = session.id; view.draw(); }}>${COMMON.rename}</button>
        ${hasVideos && hasResults ? html`<button type="button" class="button small danger-quiet" ?disabled=${isBusy} title=${isBusy ? CAPTURES.neededByJob : nothing}
          aria-label=${CAPTURES.deleteVideosOf(session.name)} @click=${removeVideos}>${CAPTURES.deleteVideos}</button>` : nothing}
        <button type="button" class="button small danger-quiet" ?disabled=${isBusy} title=${isBusy ? CAPTURES.cancelFirst : nothing}
          aria-label=${CAPTURES.deleteOf(session.name)} @click=${remove}>${COMMON.delete}</button>
      </div>` : nothing}
    </div>
    ${session.errors.length && !jobs.length ? problemBox({ message: CAPTURES.unusable, items: session.errors }) : nothing}
    ${problemBox(view.problems.get(session.id))}
    ${view.recalibrated.has(session.id) ? otherCalibrationForm(view, session) : nothing}
    ${view.opened.has(session.id) ? runAgainForm(view, session) : nothing}
    ${jobs.length ? html`<ol class="jobs">${repeat(jobs, ({ id }) => id, (job, index) => jobRow(view, job, jobs.length > 1 ? jobs.length - index : null, session.notes))}</ol>`
      : html`<p class="quiet">${CAPTURES.noJobs}</p>`}
    ${session.state === "ready" ? cameraTable(view, session) : nothing}
  </li>`;
}

// Form for another run of a capture with other choices; nothing is uploaded.

// Choices that a session states for its jobs.
const OF_SESSION = ["sync", "timeline"];

// Choices of a job that differ from the defaults; without a job from its session's.
export function jobSpec(job, options, session) {
  const stated = job?.spec ?? Object.fromEntries(OF_SESSION.map((name) => [name, session[name]]));
  const differs = ({ name, default: usual }) => (job || OF_SESSION.includes(name))
    && JSON.stringify(stated[name] ?? null) !== JSON.stringify(usual ?? null);
  return { ...Object.fromEntries(options.choices.filter(differs).map(({ name }) => [name, stated[name]])), ...pickCharacter(stated) };
}

function runAgainForm(view, session) {
  const spec = view.opened.get(session.id);
  const close = () => {
    view.opened.delete(session.id);
    view.draw();
    view.place.querySelector(`#run-${session.id}`)?.focus();
  };
  const change = (name, value) => {
    if (value === undefined) delete spec[name]; else spec[name] = value;
    view.draw();
  };
  const submit = (event) => {
    event.preventDefault();
    // The values of the form count, also against the statements of the session.
    const usual = Object.fromEntries(view.options.choices.filter(({ name }) => OF_SESSION.includes(name)).map((choice) => [choice.name, choice.default]));
    return view.act(session.id, async () => {
      const job = await call(session.urls.jobs, { method: "POST", body: { ...usual, ...spec } });
      feed.put(job);
      close();
      announce(CAPTURES.again.said(session.name));
    });
  };
  const { preflight } = session;
  const counts = preflight.cameras.map(({ num_frames: number }) => number);
  const isVideo = session.files.some(({ kind }) => kind === "video");
  const valueNote = (choice, value) => {
    const wanted = { ...spec, profile: value };
    return isVideo && choice.name === "profile" ? estimateTime(wanted, countCameraFrames(counts, wanted), feed.newest(), view.options)?.text : null;
  };
  return html`<form class="again" id="again-${session.id}" aria-label=${CAPTURES.again.label(session.name)} @submit=${submit}>
    ${choicesForm({ id: `again-${session.id}`, options: view.options, spec, onChange: change, hidden: is3d(session) ? OF_CAMERAS : [], valueNote })}
    <label class="tile"><input type="checkbox" .checked=${spec.apply_edits !== false} @change=${(event) => change("apply_edits", event.target.checked ? undefined : false)}><span class="tile-label">${CAPTURES.again.applyEdits}</span></label>
    <div class="actions"><button class="button primary">${CAPTURES.again.submit}</button>
      <button type="button" class="button" @click=${close}>${COMMON.close}</button></div>
  </form>`;
}

// Form that makes a capture of the footage of another one, with another calibration; nothing is uploaded.

function otherCalibrationForm(view, session) {
  const calibrations = view.recalibrated.get(session.id);
  const close = () => {
    view.recalibrated.delete(session.id);
    view.draw();
    view.place.querySelector(`#recalibrate-${session.id}`)?.focus();
  };
  const submit = (event) => {
    event.preventDefault();
    const { name, calibration } = event.target.elements;
    return view.act(session.id, async () => {
      const body = { session_id: session.id, calibration_id: calibration.value, manifest: { name: name.value.trim() || session.name } };
      const made = await call("/v1/sessions", { method: "POST", body });
      close();
      await view.load();
      announce(CAPTURES.other.said(made.name));
      view.place.querySelector(`#run-${made.id}`)?.focus();
    });
  };
  return html`<form class="again" aria-label=${CAPTURES.other.label(session.name)} @submit=${submit}>
    <div class="pair">
      ${selectField(COMMON.calibration, listed(calibrations), { name: "calibration" })}
      <label class="field"><span>${CAPTURES.other.name}</span><input name="name" maxlength="200" value=${session.name} autocomplete="off"></label>
    </div>
    ${calibrations.length ? "" : html`<p class="quiet">${CAPTURES.other.none} <a href="#/calibrations">${CAPTURES.other.add}</a></p>`}
    <div class="actions"><button class="button primary" ?disabled=${calibrations.length === 0}>${CAPTURES.other.submit}</button>
      <button type="button" class="button" @click=${close}>${COMMON.close}</button></div>
  </form>`;
}
