// Part of the view Record with the takes: start and stop, clips of the phones, and what is made of them.

import { choicesForm } from "../../send/choices.js";
import { feed } from "../../shared/feed.js";
import { clock, count } from "../../shared/format.js";
import { jobState } from "../../shared/jobs.js";
import { confirm, html, live as held, nothing, repeat, typed, warningList } from "../../shared/lit.js";
import { address } from "../../shared/page.js";
import { dated } from "../../shared/resources.js";
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
  return html`<section class="panel record-control" aria-labelledby="control-title"><h2 id="control-title">Take</h2>
    <form @submit=${start}>
      <div class="pair">
        <label class="field"><span>Name of the next take</span><input name="take" maxlength="200" placeholder="Take ${recording.state.recording.takes.length + 1}" autocomplete="off" .value=${typed(view.takeName)} @input=${(event) => { view.takeName = event.target.value; }}></label>
        <label class="field"><span>Video</span><select name="video" @change=${(event) => { view.videoChoice = event.target.value; view.draw(); }}>
          <option value="best" .selected=${held(view.videoChoice === "best")}>The best that all can${view.best() ? ` (${videoWords(view.best())})` : ""}</option>
          <option value="own" .selected=${held(view.videoChoice === "own")}>Each phone as it is now</option>
          ${videos.map((video) => html`<option value=${videoWords(video)} .selected=${held(view.videoChoice === videoWords(video))}>${videoWords(video)}</option>`)}</select></label>
      </div>
      <div class="actions">
        ${running ? html`<button type="button" class="button danger record-button" @click=${() => recording.send({ type: "stop" })}>Stop</button>
          <b class="record-time" role="timer">${passedS < 0 ? `${running.name} starts in ${Math.ceil(-passedS)}` : `${running.name} · ${clock(passedS)}`}</b>`
    : html`<button class="button primary record-button" ?disabled=${numReady === 0 || !recording.isConnected}>Record</button>
          <span class="quiet">${count(numReady, "phone")} ready</span>`}
        <button type="button" class="button" @click=${() => slate()}>Slate</button>
      </div>
      <label class="with"><input type="checkbox" .checked=${held(recording.sendsAtOnce)} @change=${(event) => { recording.sendsAtOnce = event.target.checked; }}> Phones send each take as soon as it is recorded</label>
    </form>
    <p class="quiet">The slate flashes this screen and beeps: turn it to the phones. Clocks are measured without it, too.</p></section>`;
}

/** Calibration of the takes: a stored one, and how to make one. */
export function calibrationPart(view) {
  const { calibrations, calibrationId } = view;
  return html`<section class="panel record-calibration" aria-labelledby="calibration-title"><h2 id="calibration-title">Calibration</h2>
    <label class="field"><span>Where the phones stand</span><select name="calibration" @change=${(event) => { view.calibrationId = event.target.value; view.draw(); }}>
      <option value="" .selected=${held(!calibrationId)}>${calibrations.length ? "Choose …" : "None yet: make one of a take"}</option>
      ${calibrations.map((calibration) => html`<option value=${calibration.id} .selected=${held(calibration.id === calibrationId)}>${dated(calibration)}</option>`)}</select></label>
    <p class="quiet">Record a take in which one person of known stature walks about for a minute where the phones see them whole, and choose <i>Calibrate</i> at the take.
      Or hold a board, <a href="/portal/record/board.html" target="_blank" rel="noopener">shown full screen or printed</a>. It serves all takes as long as no phone moves.</p></section>`;
}

function clipRow(take, clip, phones) {
  const phone = phones.find(({ number }) => number === clip.phone);
  const { words, tone } = clipState(clip, phone?.live, take.number);
  const losses = clipLosses(clip, take.start_s);
  return html`<li><b>${phone?.name ?? `Phone ${clip.phone}`}</b> <span class="badge" data-tone=${tone === "warn" ? "warn" : nothing}>${words}</span>
    ${losses.length ? html`<span class="phone-lost">${losses.join("; ")}</span>` : nothing}</li>`;
}

function jobPart(jobId, sessionName) {
  const job = feed.jobs.get(jobId);
  if (!job) return html`<a href=${address("jobs", jobId)}>Look at ${sessionName}</a>`;
  const { words, tone } = jobState(job);
  return html`<p class="record-job"><span class="state" data-tone=${tone}>${words}</span> <a href=${address("jobs", jobId)} aria-label="Look at ${sessionName}">Look</a></p>
    ${errorBox(job)}
    ${warningList(job.warnings, `Warnings of ${sessionName}`)}`;
}

function calibrationJob(view, take) {
  const job = feed.jobs.get(take.calibration_id);
  const calibration = view.calibrations.find(({ id }) => id === take.calibration_id);
  if (!job && !calibration) return nothing;
  const { words, tone } = calibration ? { words: "Calibration ready", tone: "good" } : jobState(job);
  return html`<p class="record-job"><span class="state" data-tone=${tone}>${calibration ? words : `Calibration: ${words}`}</span></p>
    ${job ? errorBox(job) : nothing}
    ${warningList(calibration?.warnings, `Warnings of the calibration of ${take.name}`)}`;
}

function calibrateForm(view, recording, take) {
  const submit = async (event) => {
    event.preventDefault();
    const { kind, stature, board } = event.target.elements;
    const choices = kind.value === "people" ? { stature_m: stature.value.split(/[\s,;]+/).filter(Boolean).map(Number) } : { board: board.value.trim() };
    if (await recording.calibrate(take, choices)) view.show(take.number, null);
  };
  const isBoard = view.calibratedBy === "board";
  return html`<form class="record-form" aria-label="Calibrate from ${take.name}" @submit=${submit}>
    <label class="field"><span>From</span><select name="kind" @change=${(event) => { view.calibratedBy = event.target.value; view.draw(); }}>
      <option value="people" .selected=${held(!isBoard)}>People who walk about</option><option value="board" .selected=${held(isBoard)}>A board</option></select></label>
    ${isBoard ? html`<label class="field"><span>Board, as its page states it</span><input name="board" required maxlength="100" placeholder="charuco:7x5:0.032:0.024:DICT_4X4_50" autocomplete="off" .value=${typed(view.board)}></label>`
    : html`<label class="field"><span>Stature in metres; of several people with a comma</span><input name="stature" required maxlength="60" placeholder="1.78" inputmode="decimal" autocomplete="off"></label>`}
    <div class="actions"><button class="button primary">Calibrate</button><button type="button" class="button" @click=${() => view.show(take.number, null)}>Close</button></div></form>`;
}

function reconstructForm(view, recording, take) {
  const submit = async (event) => {
    event.preventDefault();
    const made = await recording.reconstruct(take, view.calibrationId, view.spec);
    if (made) view.show(take.number, null);
  };
  const change = (name, value) => {
    if (value === undefined) delete view.spec[name]; else view.spec[name] = value;
    view.draw();
  };
  return html`<form class="record-form" aria-label="Reconstruct ${take.name}" @submit=${submit}>
    ${choicesForm({ id: `take-${take.number}`, options: view.options, spec: view.spec, onChange: change, hidden: ["sync"] })}
    <div class="actions"><button class="button primary" ?disabled=${!view.calibrationId}>Reconstruct</button><button type="button" class="button" @click=${() => view.show(take.number, null)}>Close</button>
      ${view.calibrationId ? nothing : html`<span class="quiet">Choose the calibration of the phones above.</span>`}</div></form>`;
}

function takeCard(view, recording, take) {
  const { number, name, state, clips, is_upload_wanted: isWanted, session_id: sessionId, job_id: jobId, calibration_id: calibrationId } = take;
  const { phones } = recording;
  const states = clips.map((clip) => clipState(clip, phones.find((phone) => phone.number === clip.phone)?.live, number));
  const numHere = states.filter(({ isHere }) => isHere).length;
  const isRecorded = state !== "recording";
  const discard = async () => {
    const text = sessionId ? "The capture that was made from it stays." : "Its clips are removed from the service and from the phones.";
    if (await confirm({ title: `Discard ${name}?`, text, action: "Discard the take" })) recording.send({ type: "discard", take: number });
  };
  const opened = view.shown.get(number);
  const canUse = isRecorded && numHere >= 2;
  return html`<li class="record-take"><div class="head"><div><h3>${number}. ${name}</h3>
      <p class="quiet facts"><span>${clock(takeDurationS(take, recording.serverS))}</span><span>${numHere} of ${count(clips.length, "clip")} here</span></p></div>
    ${state === "recording" ? html`<span class="state" data-tone="bad">recording</span>` : nothing}</div>
    ${sessionId && clips.length === 0 ? nothing : html`<ul class="record-clips" aria-label="Clips of ${name}">${clips.map((clip) => clipRow(take, clip, phones))}</ul>`}
    ${calibrationId ? calibrationJob(view, take) : nothing}
    ${jobId ? jobPart(jobId, name) : nothing}
    ${warningList(recording.warnings.get(number), `Left out of ${name}`)}
    <div class="actions">
      ${isRecorded && !isWanted ? html`<button type="button" class="button small" aria-label="Ask for the clips of ${name}" @click=${() => recording.send({ type: "upload", take: number })}>Ask for the clips</button>` : nothing}
      ${sessionId ? nothing : html`<button type="button" class="button small primary" ?disabled=${!canUse} aria-label="Reconstruct ${name}" @click=${() => view.show(number, "reconstruct")}>Reconstruct</button>`}
      ${sessionId || calibrationId ? nothing : html`<button type="button" class="button small" ?disabled=${!canUse} aria-label="Calibrate from ${name}" @click=${() => view.show(number, "calibrate")}>Calibrate</button>`}
      ${isRecorded ? html`<button type="button" class="button small danger-quiet" aria-label="Discard ${name}" @click=${discard}>Discard</button>` : nothing}
    </div>
    ${opened === "reconstruct" ? reconstructForm(view, recording, take) : opened === "calibrate" ? calibrateForm(view, recording, take) : nothing}</li>`;
}

/** Takes with their clips, the newest first. */
export function takesPart(view, recording) {
  const { takes } = recording;
  return html`<section class="panel" aria-labelledby="takes-title"><h2 id="takes-title">Takes</h2>
    ${takes.length ? html`<ol class="record-takes" aria-label="Takes">${repeat(takes, ({ number }) => number, (take) => takeCard(view, recording, take))}</ol>`
    : html`<p class="quiet">Nothing is recorded yet.</p>`}</section>`;
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
  const dialog = Object.assign(document.createElement("dialog"), { className: "slate", ariaLabel: "Slate" });
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
