// View Live: cameras that the service opens, or keypoints of files played into a live capture, and people in 3D.

import { calibrationPart, ChosenCalibration } from "../send/calibration.js";
import { droppedFiles } from "../send/files.js";
import { boardSpec, emptyBoard, readStatures } from "../calibrations/values.js";
import { call, persistently } from "../shared/api.js";
import { feed } from "../shared/feed.js";
import { dateAndTime, length } from "../shared/format.js";
import { helpLink, html, nothing, problemBox, prose, ref, render, typed } from "../shared/lit.js";
import { announce, go } from "../shared/page.js";
import { readCalibrations } from "../shared/resources.js";
import { COMMON, COUNTS } from "../shared/strings/common.js";
import { LIVE } from "../shared/strings/live.js";
import { SEND } from "../shared/strings/send.js";
import { ChosenCameras } from "./cameras_part.js";
import { ChosenOutputs } from "./outputs_part.js";
import { figureList, states, statusFigures } from "./status.js";

const DRAW_MS = 250;
const NOTICES = 8;
const LOOK_MS = 1500;
const ACCEPTED = ".zip,.json,.csv,.toml,.yml,.yaml,.xml,.txt,.npz,.pickle,.pkl";

export function open(place) {
  const view = new LiveView(place);
  view.start();
  return { title: LIVE.title, close: () => view.close() };
}

class LiveView {
  rig = new ChosenCalibration(() => { if (!this.calibrateFrom) this.cameras.list(this.rig.record?.cameras.map(({ name }) => name) ?? []); this.draw(); });
  cameras = new ChosenCameras(() => { this.outputs.protocols = this.cameras.devices?.protocols ?? []; this.draw(); });
  outputs = new ChosenOutputs(() => this.draw());
  source = "cameras"; // or keypoints
  stored = null; // calibrations, once they are loaded
  away = null; // why they are not
  files = null; // of the recording, as `sortedFiles` gives them
  frameRateHz = null;
  isKept = false;
  name = "";
  phase = "choosing"; // choosing, opening, playing, ending, over
  problem = null;
  ended = null; // message `ended` of the last capture
  counts = null; // figures of the capture that runs or ran last
  status = null; // latest message `status`, of cameras
  notices = []; // latest sentences about cameras
  isOver = false; // whether files are held over the page
  #draft = { calibrateFrom: null, stature: "", board: emptyBoard() }; // calibration to be made of the cameras
  #isClosed = false;
  #client = null;
  #playback = null;
  #round = 0; // number of the capture, so that an ended one opens no cameras
  #scene = null;
  #stage = null; // element of the 3D view
  #timer = 0;
  #keptName = "";

  constructor(place) {
    this.place = place;
  }

  async start() {
    this.draw();
    this.cameras.load();
    try {
      this.stored = await persistently(readCalibrations, { isOver: () => this.#isClosed, away: (problem) => { this.away = problem; this.draw(); } });
      this.away = null;
    } catch (problem) {
      this.away = problem;
    }
    this.draw();
  }

  close() {
    this.#isClosed = true;
    this.#leave();
    this.#scene?.close();
  }

  get isBusy() { return ["opening", "playing", "ending", "calibrating"].includes(this.phase); }
  get capture() { return { calibration: this.rig.record }; } // for the part that chooses the calibration
  get draft() { return this.hasCameras ? this.#draft : null; } // likewise
  get calibrateFrom() { return this.hasCameras ? this.#draft.calibrateFrom : null; }
  get hasCameras() { return this.source === "cameras"; }
  get needsFrameRate() { return !this.hasCameras && this.files !== null && this.files.views.length > 0 && this.files.timestamps === null; }

  async add(read) {
    try {
      const { sortedFiles } = await import("./keypoints.js");
      const sorted = await sortedFiles(await read);
      this.problem = null;
      if (sorted.views.length) this.files = sorted;
      else if (sorted.timestamps && this.files) this.files.timestamps = sorted.timestamps;
      else if (!sorted.calibration) this.problem = { message: LIVE.noKeypoints, hint: LIVE.noKeypointsHint };
      if (sorted.calibration) await this.rig.readFile(sorted.calibration);
    } catch (problem) {
      this.problem = problem;
    }
    if (this.files) announce(LIVE.said.files(COUNTS.cameras(this.files.views.length)));
    this.draw();
  }

  assignDraft(facts) {
    Object.assign(this.#draft, facts);
    if (this.#draft.calibrateFrom) this.cameras.rename();
    this.draw();
  }

  async play() {
    this.problem = this.ended = null;
    const missing = [
      ...(this.hasCameras ? this.cameras.faults : this.files ? [] : [LIVE.faults.keypoints]),
      ...(this.rig.record || this.calibrateFrom ? [] : [LIVE.faults.calibration]),
      ...(this.calibrateFrom === "people" && !readStatures(this.#draft.stature) ? [LIVE.faults.stature] : []),
      ...(this.needsFrameRate && !(this.frameRateHz >= 1 && this.frameRateHz <= 1000) ? [LIVE.faults.rate] : []),
    ];
    if (missing.length) {
      this.problem = { message: LIVE.incomplete, items: missing.map((message) => ({ message })) };
      this.draw();
      return;
    }
    this.#go("opening");
    const round = this.#round;
    try {
      // The player is large: it is loaded when it is needed.
      const [{ LiveClient }, { LiveScene }] = await Promise.all([import("./client.js"), this.calibrateFrom ? {} : import("./scene.js")]);
      if (round !== this.#round) return;
      if (this.calibrateFrom) {
        this.#record(LiveClient);
        return;
      }
      const open = (start, rateHz = null) => this.#open(new LiveClient({ calibration_id: this.rig.id, keep: this.isKept, name: this.#named(), ...start }), LiveScene, rateHz);
      if (this.hasCameras) await open({ ...this.cameras.start, outputs: this.outputs.addresses });
      else {
        const [{ openRecording }, { Playback }] = await Promise.all([import("./keypoints.js"), import("./playback.js")]);
        const recording = await openRecording(this.files, this.rig.record.cameras.map(({ name }) => name), this.frameRateHz);
        const ready = round === this.#round ? await open({ layout: recording.layout, frame_rate_hz: recording.rateHz }, recording.rateHz) : null;
        if (ready) this.#playBack(new Playback(this.#client, recording, ready.cameras));
      }
    } catch (problem) {
      this.#over(problem);
    }
  }

  // Send a simulated person to the outputs.
  async playPattern() {
    this.problem = this.ended = null;
    this.#go("opening");
    try {
      const [{ LiveClient }, { LiveScene }] = await Promise.all([import("./client.js"), import("./scene.js")]);
      await this.#open(new LiveClient({ type: "start_test_pattern", outputs: this.outputs.addresses }), LiveScene);
    } catch (problem) {
      this.#over(problem);
    }
  }

  // Record the cameras, and choose the calibration of them once it is made.
  #record(LiveClient) {
    const { board, stature } = this.#draft;
    const by = this.calibrateFrom === "board" ? { board: boardSpec(board) } : { stature_m: readStatures(stature) };
    const { used: cameras, durationS } = this.cameras;
    this.#watch(new LiveClient({ type: "record_cameras", cameras, duration_s: durationS, ...by }));
    this.#client.addEventListener("recorded", ({ detail }) => this.#choose(detail.calibration_id));
  }

  // Choose a calibration as soon as it is made.
  async #choose(id) {
    this.#go("calibrating");
    try {
      let made;
      do {
        await new Promise((resolve) => { setTimeout(resolve, LOOK_MS); });
        made = await persistently(() => call(`/v1/calibrations/${id}`), { isOver: () => this.#isClosed, away: () => null });
      } while (!this.#isClosed && ["queued", "running"].includes(made.state));
      if (this.#isClosed) return;
      if (made.state !== "ready") throw Object.assign(new Error(LIVE.cameras.unmade), { hint: [made.error?.detail, made.error?.hint].filter(Boolean).join(" ") });
      this.#draft.calibrateFrom = null;
      await this.rig.choose(id, made.name);
      this.#over(null, LIVE.said.calibrated);
    } catch (problem) {
      this.#over(problem);
    }
  }

  #watch(client) {
    Object.assign(this, { status: null, notices: [] });
    this.#client = client;
    this.#playback = null;
    client.addEventListener("refused", ({ detail }) => this.#over(detail));
    client.addEventListener("notice", ({ detail }) => { this.notices = [...this.notices, detail.message].slice(-NOTICES); this.draw(); });
  }

  #named() {
    this.#keptName = this.name.trim() || LIVE.defaultName(dateAndTime(new Date()));
    return this.#keptName;
  }

  // Wait until a capture has begun; returns its message `ready`. One that was left meanwhile never begins.
  async #open(client, LiveScene, rateHz) {
    this.#watch(client);
    client.addEventListener("ended", ({ detail }) => { this.ended = detail; this.#over(null); });
    client.addEventListener("status", ({ detail }) => { this.status = detail; this.draw(); });
    const ready = await client.ready;
    this.counts = { people: 0, skeletons: 0, instants: 0, dropped: { input: 0, output: 0 }, notSent: 0 };
    this.draw();
    this.#scene?.close();
    this.#scene = new LiveScene(this.#stage, ready, ready.frame_rate_hz ?? rateHz);
    client.addEventListener("instant", ({ detail }) => this.#take(detail));
    this.#timer = setInterval(() => this.draw(), DRAW_MS);
    this.#go("playing");
    announce(LIVE.said.begun);
    return ready;
  }

  #playBack(playback) {
    this.#playback = playback;
    playback.addEventListener("end", () => this.end());
    playback.addEventListener("problem", ({ detail }) => this.#over(detail));
    playback.start();
  }

  #take(instant) {
    this.#scene.show(instant);
    this.#playback?.arrived(instant);
    const { people, dropped } = instant;
    Object.assign(this.counts, {
      people: people.length, skeletons: people.filter(({ skeleton }) => skeleton).length, instants: this.counts.instants + 1, dropped, notSent: this.#client.notSent,
    });
  }

  // End the capture; the service sends what is still to come, and stores what is to be kept.
  end() {
    this.#playback?.stop();
    if (this.phase === "opening") {
      this.#over(null);
      return;
    }
    this.#client.end();
    this.#go("ending");
  }

  #leave() {
    clearInterval(this.#timer);
    this.#playback?.stop();
    this.#client?.close();
    this.#round += 1;
  }

  #over(problem, said = LIVE.said.over) {
    if (this.#isClosed) return;
    this.#leave();
    this.problem = problem;
    this.#go("over");
    announce(problem ? LIVE.said.failed : said);
  }

  #go(phase) {
    this.phase = phase;
    this.draw();
  }

  async reconstruct() {
    try {
      const job = await call(`/v1/sessions/${this.ended.session_id}/jobs`, { method: "POST", body: {} });
      feed.put(job);
      go("jobs", job.id);
    } catch (problem) {
      this.problem = problem;
      this.draw();
    }
  }

  draw() {
    if (!this.#isClosed) render(this.#page(), this.place);
  }

  #page() {
    const over = (isOver) => { if (this.isOver !== isOver) { this.isOver = isOver; this.draw(); } };
    return html`<form class="live" novalidate @submit=${(event) => { event.preventDefault(); if (!this.isBusy) this.play(); }}
        @dragover=${(event) => { event.preventDefault(); over(true); }}
        @dragleave=${(event) => { if (!this.place.contains(event.relatedTarget)) over(false); }}
        @drop=${(event) => { event.preventDefault(); over(false); if (!this.isBusy) this.add(droppedFiles(event.dataTransfer)); }}>
      <div class="bar"><div class="with-help"><h1 class="title">${LIVE.title}</h1>${helpLink("live", LIVE.title)}</div>
        <p class="quiet">${prose(LIVE.hint)}</p></div>
      <section class="look-viewer" aria-label=${LIVE.peopleNow} ?hidden=${this.counts === null}>
        <div class="look-view live-stage" ${ref((element) => { this.#stage = element ?? null; })}></div>
        ${this.counts ? this.#figures() : nothing}
      </section>
      ${this.#waiting()}
      ${this.notices.length ? html`<div role="log" aria-label=${LIVE.notices}><ul class="warnings">${this.notices.map((text) => html`<li>${text}</li>`)}</ul></div>` : nothing}
      ${this.status ? states(this.status) : nothing}
      ${this.#result()}
      ${problemBox(this.problem)}
      <div class="actions">
        <button class="button primary" ?disabled=${this.isBusy}>${this.phase === "opening" ? LIVE.opening : this.#action()}</button>
        <button type="button" class="button" ?disabled=${!["opening", "playing"].includes(this.phase)} @click=${() => this.end()}>${this.phase === "ending" ? LIVE.ending : LIVE.end}</button>
        <label class="with"><input type="checkbox" .checked=${this.isKept} ?disabled=${this.isBusy} @change=${(event) => { this.isKept = event.target.checked; this.draw(); }}> ${LIVE.keep}</label>
        ${this.isKept ? html`<label class="take"><span>${COMMON.name}</span><input name="name" maxlength="200" autocomplete="off" .value=${typed(this.name)} ?disabled=${this.isBusy} @input=${(event) => { this.name = event.target.value; }}></label>` : nothing}
      </div>
      <fieldset class="field" ?disabled=${this.isBusy}><legend>${LIVE.from}</legend><div class="choices">
        ${Object.entries(LIVE.sources).map(([source, label]) => html`<label class="with"><input type="radio" name="source" value=${source} .checked=${source === this.source} @change=${() => { this.source = source; this.draw(); }}> ${label}</label>`)}</div></fieldset>
      ${this.hasCameras ? nothing : this.#filesPart()}
      <section class="panel" aria-labelledby="calibration-title"><div class="with-help"><h2 id="calibration-title">${COMMON.calibration}</h2>${helpLink("calibration", COMMON.calibration)}</div>
        ${calibrationPart({ sending: this, stored: this.stored, away: this.away, isLocked: this.isBusy, choose: (id, name) => this.rig.choose(id, name), readFile: (...chosen) => { this.#draft.calibrateFrom = null; return this.rig.readFile(...chosen); } })}
        ${problemBox(this.rig.problem)}
      </section>
      ${this.hasCameras ? this.cameras.part(this.isBusy) : nothing}
      ${this.hasCameras && !this.calibrateFrom ? this.outputs.part(this.isBusy, () => this.playPattern()) : nothing}
    </form>`;
  }

  #waiting() {
    const { waiting, recording, made } = LIVE.cameras;
    const text = { opening: this.calibrateFrom ? recording : waiting, calibrating: made }[this.phase];
    return this.hasCameras && text ? html`<p class="notice" role="status">${text}</p>` : nothing;
  }

  #action() {
    if (this.calibrateFrom) return LIVE.cameras.record;
    if (this.hasCameras) return this.counts ? LIVE.startAgain : LIVE.start;
    return this.counts ? LIVE.playAgain : LIVE.play;
  }

  #filesPart() {
    const { views = [], timestamps, others = [] } = this.files ?? {};
    const chosen = (event) => {
      const files = [...event.target.files];
      event.target.value = "";
      this.add(files);
    };
    const picker = (label, attributes) => html`<label class="button">${label}${attributes}</label>`;
    return html`<section class="panel" aria-labelledby="keypoints-title"><div class="with-help"><h2 id="keypoints-title">${LIVE.keypoints}</h2>${helpLink("keypoints", LIVE.keypoints)}</div>
      <div class="drop ${this.isOver ? "over" : ""} ${views.length ? "small" : ""}">
        ${views.length ? nothing : html`<p class="lead">${LIVE.lead}</p>`}
        <div class="actions">
          ${picker(SEND.chooseFiles, html`<input class="unseen" type="file" multiple accept=${ACCEPTED} ?disabled=${this.isBusy} @change=${chosen}>`)}
          ${picker(SEND.chooseFolder, html`<input class="unseen" type="file" webkitdirectory ?disabled=${this.isBusy} @change=${chosen}>`)}
        </div>
        <p class="quiet">${LIVE.keypointsHint} ${LIVE.leadHint}</p>
      </div>
      ${views.length ? html`<p class="quiet facts">${views.map(({ name, frames }) => html`<span>${LIVE.framesOf(name, COUNTS.frames(frames.size))}</span>`)}
        ${timestamps ? html`<span>${LIVE.timesOf(timestamps.name)}</span>` : nothing}</p>` : nothing}
      ${others.length ? html`<p class="notice" role="status">${LIVE.leftOut(others.join(", "))}</p>` : nothing}
      ${this.needsFrameRate ? html`<label class="field clock"><span>${SEND.rate}</span>
        <input type="number" class="number" min="1" max="1000" step="any" .value=${typed(this.frameRateHz)} ?disabled=${this.isBusy}
          @input=${(event) => { this.frameRateHz = event.target.value === "" ? null : event.target.valueAsNumber; }}>
        <span class="quiet">${SEND.rateHint}</span></label>` : nothing}
    </section>`;
  }

  #figures() {
    const { people, skeletons, instants, dropped, notSent } = this.counts;
    const shown = LIVE.peopleNumber(people, skeletons);
    if (this.status) return statusFigures(this.status, shown);
    const { figures } = LIVE;
    const [playback, latency] = [this.#playback, this.#playback?.latencyMs?.map((value) => value.toFixed(0))];
    return figureList([
      [figures.time, playback ? LIVE.timeOf(length(playback.timeS), length(playback.lengthS)) : LIVE.unknown],
      [figures.people, shown],
      [figures.latency, latency ? LIVE.latency(...latency) : LIVE.unknown],
      [figures.instants, String(instants)],
      [figures.dropped, LIVE.dropped(COUNTS.frames(dropped.input + notSent), COUNTS.instants(dropped.output))],
    ]);
  }

  #result() {
    if (this.ended === null) return nothing;
    const { session_id: sessionId, kept_frames: kept, counts } = this.ended;
    if (sessionId === null) return html`<p class="notice" role="status">${LIVE.over(COUNTS.frames(counts.received))}</p>`;
    return html`<div class="notice live-result" role="status"><p>${LIVE.kept(COUNTS.frames(kept), counts.received)}<a href="#/captures?${new URLSearchParams({ name: this.#keptName })}">${LIVE.keptLink}</a>.</p>
      <button type="button" class="button small primary" @click=${() => this.reconstruct()}>${LIVE.reconstruct}</button></div>`;
  }
}
