// View of one recording as its host sees it.

import { announce } from "../../shared/announce.js";
import { call } from "../../shared/api.js";
import { persistently } from "../../shared/away.js";
import { readCalibrations, usable } from "../../shared/calibrations.js";
import { confirm } from "../../shared/dialog.js";
import { feed } from "../../shared/feed.js";
import { html, nothing, render } from "../../shared/lit.js";
import { readOptions } from "../../shared/options.js";
import { problemBox } from "../../shared/problem.js";
import { go } from "../../shared/router.js";
import { shownBoard } from "../board/charuco.js";
import { keepJoin } from "../join_links.js";
import { joinPart, phonesPart } from "./phones_part.js";
import { HostedRecording } from "./recording.js";
import { calibrationPart, recordPart, takesPart } from "./takes_part.js";
import { bestVideo, commonVideos, videoWords } from "./video_settings.js";

const TICK_MS = 500;

/** View of one recording. */
export class RecordingView {
  #isClosed = false;
  #chosen = new Set(); // calibrations that were chosen by themselves
  #read = new Set(); // jobs of calibrations after which the list was read
  #timer = setInterval(() => { if (this.recording.running) this.draw(); }, TICK_MS);
  calibrations = [];
  calibrationId = "";
  options = null;
  spec = {}; // choices of the next jobs
  takeName = "";
  askedName = ""; // name of the take that was asked for, until it has begun: the service may refuse it
  videoChoice = "best";
  calibratedBy = "people";
  board = shownBoard(); // that this browser showed last
  renamed = null; // number of the phone whose name is changed
  shown = new Map(); // form that is open, by the number of its take

  constructor(place, id) {
    this.place = place;
    this.recording = new HostedRecording(id);
    this.recording.addEventListener("change", this.#followed);
    feed.addEventListener("change", this.#onFeed);
    this.draw();
    this.recording.open();
    for (const loading of [this.#loadCalibrations(), readOptions().then((options) => { this.options = options; this.draw(); })]) {
      loading.catch((problem) => { this.recording.problem = problem; this.draw(); });
    }
  }

  close() {
    this.#isClosed = true;
    clearInterval(this.#timer);
    this.recording.close();
    feed.removeEventListener("change", this.#onFeed);
  }

  /** Sizes and rates that all connected phones can. */
  videos() {
    return commonVideos(this.recording.phones.map(({ live }) => live?.is_connected && live.hello?.capabilities).filter(Boolean));
  }

  best() {
    return bestVideo(this.videos());
  }

  /** Size and rate that phones are asked for; null: what each has. */
  video() {
    if (this.videoChoice === "own") return null;
    return this.videos().find((video) => videoWords(video) === this.videoChoice) ?? this.best();
  }

  /** Show a form of a take, or none. */
  show(number, form) {
    if (form === null) this.shown.delete(number);
    else this.shown.set(number, form);
    this.draw();
  }

  async #loadCalibrations() {
    this.calibrations = usable(await persistently(readCalibrations, { isOver: () => this.#isClosed }));
    this.#followed();
  }

  // The newest calibration that was made of a take of this recording is chosen, so that the next takes need no choice.
  #chooseNewest() {
    const ids = this.recording.state?.recording.takes.map((take) => take.calibration_id) ?? [];
    const newest = ids.findLast((id) => this.calibrations.some((calibration) => calibration.id === id));
    if (!newest || this.#chosen.has(newest)) return;
    this.#chosen.add(newest);
    this.calibrationId = newest;
    announce("The calibration of the phones is chosen.");
  }

  // A calibration of a take may be ready: the list is read again, once.
  #onFeed = () => {
    const ids = this.recording.state?.recording.takes.map((take) => take.calibration_id) ?? [];
    const ready = ids.filter((id) => feed.jobs.get(id)?.state === "succeeded" && !this.#read.has(id));
    for (const id of ready) this.#read.add(id);
    if (ready.length) this.#loadCalibrations().catch(() => null);
    this.draw();
  };

  #followed = () => {
    this.#chooseNewest();
    if (this.askedName && this.recording.running?.name === this.askedName) this.takeName = this.askedName = "";
    this.draw();
  };

  async #remove() {
    const { name } = this.recording.state.recording;
    const text = "Phones are sent away, and takes of which no capture was made are removed.";
    if (!await confirm({ title: `Delete ${name}?`, text, action: "Delete the recording" })) return;
    try {
      await call(this.recording.path, { method: "DELETE" });
      keepJoin(this.recording.id, null);
      go("record");
    } catch (problem) {
      this.recording.problem = problem;
      this.draw();
    }
  }

  draw() {
    if (this.#isClosed) return;
    const { recording } = this;
    const { state, problem } = recording;
    if (state === null) {
      render(html`<h1 class="title">Record</h1>${problem ? problemBox(problem) : html`<p class="quiet">Loading …</p>`}<p><a href="#/record">All recordings</a></p>`, this.place);
      return;
    }
    render(html`<div class="bar"><h1 class="title">${state.recording.name}</h1><a href="#/record">All recordings</a>
        <button type="button" class="button small danger-quiet record-delete" @click=${() => this.#remove()}>Delete the recording</button></div>
      ${problemBox(problem)}
      ${recording.isConnected ? nothing : html`<p class="notice" role="status">The service does not answer. It is asked again until it does; phones that record go on.</p>`}
      ${state.relay === "away" ? html`<p class="notice" role="status">The broker of the service does not answer: some phones are seen late, or not at all. Recording goes on.</p>` : nothing}
      <div class="record-room">
        <div class="record-side">${joinPart(recording)}${calibrationPart(this)}</div>
        <div class="record-main">${recordPart(this, recording)}${phonesPart(this, recording)}${takesPart(this, recording)}</div>
      </div>`, this.place);
  }
}
