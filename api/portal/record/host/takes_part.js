// Part of the view Record with the takes: start and stop, clips of the phones, and what is made of them.

import { statureField } from "../../calibrations/fields.js";
import { readStatures } from "../../calibrations/values.js";
import { choicesForm } from "../../send/choices.js";
import { sending } from "../../send/sending.js";
import { feed } from "../../shared/feed.js";
import { clock } from "../../shared/format.js";
import { jobState } from "../../shared/jobs.js";
import { confirm, helpLink, html, live as held, nothing, repeat, selectField, typed, warningList } from "../../shared/lit.js";
import { address } from "../../shared/page.js";
import { listed } from "../../shared/resources.js";
import { COMMON, COUNTS } from "../../shared/strings/common.js";
import { RECORD } from "../../shared/strings/record.js";
import { errorBox } from "../../watch/job_row.js";
import { cleanName } from "../room.js";
import { clipLosses, clipState, takeDurationS, videoWords } from "./state_words.js";

const READY = ["ready", "sending"];

/** Start and stop of a take. */
export function recordPart(view, recording) {
  const { running, phones } = recording;
  const numReady = phones.filter(({ live }) => live?.is_connected && READY.includes(live.status?.state)).length;
  const start = (event) => {
    event.preventDefault();
    const settings = view.video();
    const name = cleanName(view.takeName, 200);
    recording.send({ type: "start", ...(name && { name }), ...(settings && { settings }) });
    view.askedName = name;
  };
  const passedS = running ? recording.serverS - running.start_s : 0;
  const videos = view.videos();
  return html`<section class="panel record-control" aria-labelledby="control-title"><h2 id="control-title">${RECORD.take}</h2>
    <form @submit=${start}>
      <div class="pair">
        <label class="field"><span>${RECORD.takeName}</span><input name="take" maxlength="200" placeholder=${RECORD.takeDefault(recording.state.recording.takes.length + 1)} autocomplete="off" .value=${typed(view.takeName)} @input=${(event) => { view.takeName = event.target.value; }}></label>
        ${selectField(RECORD.video, [["best", RECORD.best(view.best() && videoWords(view.best()))], ["own", RECORD.own], ...videos.map((video) => [videoWords(video), videoWords(video)])],
    { name: "video", chosen: view.videoChoice, choose: (choice) => { view.videoChoice = choice; view.draw(); } })}
      </div>
      <div class="actions">
        ${running ? html`<button type="button" class="button danger record-button" @click=${() => recording.send({ type: "stop" })}>${RECORD.stop}</button>
          <b class="record-time" role="timer">${passedS < 0 ? RECORD.startsIn(running.name, Math.ceil(-passedS)) : RECORD.running(running.name, clock(passedS))}</b>`
    : html`<button class="button primary record-button" ?disabled=${numReady === 0 || !recording.isConnected}>${RECORD.record}</button>
          <span class="quiet">${RECORD.ready(COUNTS.phones(numReady))}</span>`}
        <button type="button" class="button" @click=${() => slate()}>${RECORD.slate}</button>
      </div>
      <label class="with"><input type="checkbox" .checked=${held(recording.sendsAtOnce)} @change=${(event) => { recording.sendsAtOnce = event.target.checked; }}> ${RECORD.sendAtOnce}</label>
    </form>
    <p class="quiet">${RECORD.slateHint}</p></section>`;
}

/** Calibration of the takes: a stored one, and how to make one. */
export function calibrationPart(view) {
  const { calibrations, calibrationId } = view;
  return html`<section class="panel record-calibration" aria-labelledby="calibration-title"><div class="with-help"><h2 id="calibration-title">${COMMON.calibration}</h2>${helpLink("calibration", COMMON.calibration)}</div>
    ${selectField(RECORD.where, [["", calibrations.length ? COMMON.choose : RECORD.noCalibration], ...listed(calibrations)],
    { name: "calibration", chosen: calibrationId, choose: (id) => { view.calibrationId = id; view.draw(); } })}
    <p class="quiet">${RECORD.calibrationHint}
      ${RECORD.boardHint} <a href="/portal/record/board.html" target="_blank" rel="noopener">${RECORD.boardLink}</a>. ${RECORD.calibrationHolds}</p></section>`;
}

function clipRow(take, clip, phones) {
  const phone = phones.find(({ number }) => number === clip.phone);
  const { words, tone } = clipState(clip, phone?.live, take.number);
  const losses = clipLosses(clip, take.start_s);
  return html`<li><b>${phone?.name ?? RECORD.phoneDefault(clip.phone)}</b> <span class="badge" data-tone=${tone === "warn" ? "warn" : nothing}>${words}</span>
    ${losses.length ? html`<span class="phone-lost">${losses.join("; ")}</span>` : nothing}</li>`;
}

function jobPart(jobId, sessionName) {
  const job = feed.jobs.get(jobId);
  if (!job) return html`<a href=${address("jobs", jobId)}>${RECORD.openOf(sessionName)}</a>`;
  const { words, tone } = jobState(job);
  return html`<p class="record-job"><span class="state" data-tone=${tone}>${words}</span> <a href=${address("jobs", jobId)} aria-label=${RECORD.openOf(sessionName)}>${RECORD.open}</a></p>
    ${errorBox(job)}
    ${warningList(job.warnings, COMMON.warningsOf(sessionName))}`;
}

function calibrationJob(view, take) {
  const job = feed.jobs.get(take.calibration_id);
  const calibration = view.calibrations.find(({ id }) => id === take.calibration_id);
  if (!job && !calibration) return nothing;
  const { words, tone } = calibration ? { words: RECORD.calibrationReady, tone: "good" } : jobState(job);
  return html`<p class="record-job"><span class="state" data-tone=${tone}>${calibration ? words : RECORD.calibrationState(words)}</span></p>
    ${job ? errorBox(job) : nothing}
    ${warningList(calibration?.warnings, RECORD.warningsOfCalibration(take.name))}`;
}

function calibrateForm(view, recording, take) {
  const submit = async (event) => {
    event.preventDefault();
    const { kind, stature, board } = event.target.elements;
    const choices = kind.value === "people" ? { stature_m: readStatures(stature.value) } : { board: board.value.trim() };
    if (await recording.calibrate(take, choices)) view.show(take.number, null);
  };
  const isBoard = view.calibratedBy === "board";
  return html`<form class="record-form" aria-label=${RECORD.calibrateOf(take.name)} @submit=${submit}>
    ${selectField(RECORD.from, [["people", RECORD.byPeople], ["board", RECORD.byBoard]], { name: "kind", chosen: view.calibratedBy, choose: (by) => { view.calibratedBy = by; view.draw(); } })}
    ${isBoard ? html`<label class="field"><span>${RECORD.board}</span><input name="board" required maxlength="100" placeholder=${RECORD.boardPlaceholder} autocomplete="off" .value=${typed(view.board)}></label>`
    : statureField()}
    <div class="actions"><button class="button primary">${RECORD.calibrate}</button><button type="button" class="button" @click=${() => view.show(take.number, null)}>${COMMON.close}</button></div></form>`;
}

function reconstructForm(view, recording, take) {
  const submit = async (event) => {
    event.preventDefault();
    const made = await recording.reconstruct(take, view.calibrationId, view.spec);
    if (made) view.show(take.number, null);
  };
  const change = (name, value) => {
    if (value === undefined) delete view.spec[name]; else view.spec[name] = value;
    sending.changed();
    view.draw();
  };
  return html`<form class="record-form" aria-label=${RECORD.reconstructOf(take.name)} @submit=${submit}>
    ${choicesForm({ id: `take-${take.number}`, options: view.options, spec: view.spec, onChange: change, hidden: ["sync"] })}
    <div class="actions"><button class="button primary" ?disabled=${!view.calibrationId}>${RECORD.reconstruct}</button><button type="button" class="button" @click=${() => view.show(take.number, null)}>${COMMON.close}</button>
      ${view.calibrationId ? nothing : html`<span class="quiet">${RECORD.chooseCalibration}</span>`}</div></form>`;
}

function takeCard(view, recording, take) {
  const { number, name, state, clips, is_upload_wanted: isWanted, session_id: sessionId, job_id: jobId, calibration_id: calibrationId } = take;
  const { phones } = recording;
  const states = clips.map((clip) => clipState(clip, phones.find((phone) => phone.number === clip.phone)?.live, number));
  const numHere = states.filter(({ isHere }) => isHere).length;
  const isRecorded = state !== "recording";
  const discard = async () => {
    const { title, text, withCapture, action } = RECORD.discarding;
    if (await confirm({ title: title(name), text: sessionId ? withCapture : text, action })) recording.send({ type: "discard", take: number });
  };
  const opened = view.shown.get(number);
  const canUse = isRecorded && numHere >= 2;
  return html`<li class="record-take"><div class="head"><div><h3>${RECORD.numbered(number, name)}</h3>
      <p class="quiet facts"><span>${clock(takeDurationS(take, recording.serverS))}</span><span>${RECORD.clipsHere(numHere, COUNTS.clips(clips.length))}</span></p></div>
    ${state === "recording" ? html`<span class="state" data-tone="bad">${RECORD.recording}</span>` : nothing}</div>
    ${sessionId && clips.length === 0 ? nothing : html`<ul class="record-clips" aria-label=${RECORD.clipsOf(name)}>${clips.map((clip) => clipRow(take, clip, phones))}</ul>`}
    ${calibrationId ? calibrationJob(view, take) : nothing}
    ${jobId ? jobPart(jobId, name) : nothing}
    ${warningList(recording.warnings.get(number), RECORD.leftOut(name))}
    <div class="actions">
      ${isRecorded && !isWanted ? html`<button type="button" class="button small" aria-label=${RECORD.askOf(name)} @click=${() => recording.send({ type: "upload", take: number })}>${RECORD.ask}</button>` : nothing}
      ${sessionId ? nothing : html`<button type="button" class="button small primary" ?disabled=${!canUse} aria-label=${RECORD.reconstructOf(name)} @click=${() => view.show(number, "reconstruct")}>${RECORD.reconstruct}</button>`}
      ${sessionId || calibrationId ? nothing : html`<button type="button" class="button small" ?disabled=${!canUse} aria-label=${RECORD.calibrateOf(name)} @click=${() => view.show(number, "calibrate")}>${RECORD.calibrate}</button>`}
      ${isRecorded ? html`<button type="button" class="button small danger-quiet" aria-label=${RECORD.discardOf(name)} @click=${discard}>${RECORD.discard}</button>` : nothing}
    </div>
    ${opened === "reconstruct" ? reconstructForm(view, recording, take) : opened === "calibrate" ? calibrateForm(view, recording, take) : nothing}</li>`;
}

/** Takes with their clips, the newest first. */
export function takesPart(view, recording) {
  const { takes } = recording;
  return html`<section class="panel" aria-labelledby="takes-title"><h2 id="takes-title">${RECORD.takes}</h2>
    ${takes.length ? html`<ol class="record-takes" aria-label=${RECORD.takes}>${repeat(takes, ({ number }) => number, (take) => takeCard(view, recording, take))}</ol>`
    : html`<p class="quiet">${RECORD.noTakes}</p>`}</section>`;
}

// Slate: the screen flashes white and beeps, so that all phones see and hear the same moment.

const FLASHES_MS = [300, 900]; // fewer than three a second
const FLASH_MS = 120;
const END_MS = 1500;
const [BEEP_HZ, VOLUME] = [1000, 0.8];

function beep(audio, atS) {
  const tone = new OscillatorNode(audio, { frequency: BEEP_HZ });
  const volume = new GainNode(audio, { gain: VOLUME });
  tone.connect(volume).connect(audio.destination);
  tone.start(atS);
  tone.stop(atS + FLASH_MS / 1000);
}

/** Show the slate over the whole page; resolves when it is over. */
export async function slate() {
  const dialog = Object.assign(document.createElement("dialog"), { className: "slate", ariaLabel: RECORD.slate });
  document.body.append(dialog);
  dialog.showModal();
  await dialog.requestFullscreen?.().catch(() => null);
  const audio = new AudioContext();
  const beginS = audio.currentTime;
  for (const atMs of FLASHES_MS) {
    beep(audio, beginS + atMs / 1000);
    setTimeout(() => dialog.classList.add("lit"), atMs);
    setTimeout(() => dialog.classList.remove("lit"), atMs + FLASH_MS);
  }
  await new Promise((resolve) => { setTimeout(resolve, END_MS); });
  if (document.fullscreenElement === dialog) await document.exitFullscreen().catch(() => null);
  dialog.remove();
  await audio.close();
}
