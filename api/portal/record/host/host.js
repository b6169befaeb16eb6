// View of one recording as its host sees it.

import { call, persistently } from "../../shared/api.js";
import { feed } from "../../shared/feed.js";
import { moment } from "../../shared/format.js";
import { confirm, html, nothing, problemBox, render, repeat } from "../../shared/lit.js";
import { announce, go } from "../../shared/page.js";
import { readCalibrations, readOptions, usable } from "../../shared/resources.js";
import { shownBoard } from "../board/charuco.js";
import { cleanName, isOfThisMachine, keepJoin } from "../room.js";
import { HostedRecording } from "./recording.js";
import { calibrationPart, recordPart, takesPart } from "./takes_part.js";
import { bestVideo, commonVideos, phoneFacts, phoneState, videoWords } from "./state_words.js";

const TICK_MS = 500;

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

// Part of the view Record with the phones: how they join, and what they see.

/** Link and QR code by which phones join. */
function joinPart(recording) {
  const { join } = recording;
  const renew = async () => {
    const text = "Phones that have joined need the new link, too, before they record or send again.";
    if (join && !await confirm({ title: "Make a new link?", text, action: "Make a new link", refusal: "Keep the link" })) return;
    await recording.renewJoin();
  };
  return html`<section class="panel record-join" aria-labelledby="join-title"><h2 id="join-title">Phones join by this code</h2>
    ${join ? html`<img class="record-code" alt="QR code of the link" src=${`data:image/svg+xml,${encodeURIComponent(join.qr_svg)}`}>
      <a class="record-link" href=${join.url} target="_blank" rel="noopener">${join.url}</a>
      ${isOfThisMachine(join.url) ? html`<p class="notice" role="status">Only this machine can open this address. Start the service with <code>multicap serve --https</code>, and open this page by the address that it prints.</p>` : nothing}
      <p class="quiet">It opens this recording alone, until ${moment(join.expires_at)}. Whoever has it can join.</p>`
    : html`<p class="quiet">The link is shown once, in the browser that made the recording.</p>`}
    <div class="actions"><button type="button" class="button small" @click=${renew}>New link</button></div></section>`;
}

function phoneCard(view, recording, phone) {
  const { number, name, device, live } = phone;
  const [words, tone] = phoneState(live);
  const picture = recording.pictures.get(number);
  const remove = async () => {
    const text = "It can't come back. Clips that it has sent stay.";
    if (await confirm({ title: `Remove ${name}?`, text, action: "Remove the phone" })) recording.send({ type: "remove", phone: number });
  };
  const rename = (event) => {
    event.preventDefault();
    const wanted = cleanName(event.target.elements.name.value);
    view.renamed = null;
    if (wanted && wanted !== name) recording.send({ type: "rename", phone: number, name: wanted });
    view.draw();
  };
  return html`<li class="record-phone" data-tone=${tone}>
    <div class="record-picture">${picture && live?.is_connected ? html`<img src=${picture} alt="Picture of ${name}">` : html`<span class="quiet">no picture</span>`}</div>
    <div class="head">${view.renamed === number
    ? html`<form class="rename" @submit=${rename}><input name="name" maxlength="64" required aria-label="New name of ${name}" value=${name} autocomplete="off"><button class="button small primary">Save</button></form>`
    : html`<h3>${name}</h3>`}<span class="state" data-tone=${tone}>${words}</span></div>
    <p class="quiet facts">${phoneFacts(live).map(({ text, isWorse }) => html`<span class=${isWorse ? "worse" : ""}>${text}</span>`)}</p>
    <p class="quiet">${device}</p>
    ${live?.status?.error ? html`<p class="problem">${live.status.error}</p>` : nothing}
    <div class="actions"><button type="button" class="button small" aria-label="Rename ${name}" @click=${() => { view.renamed = number; view.draw(); }}>Rename</button>
      <button type="button" class="button small danger-quiet" aria-label="Remove ${name}" @click=${remove}>Remove</button></div></li>`;
}

function phonesPart(view, recording) {
  const { phones } = recording;
  return html`<section class="panel" aria-labelledby="phones-title"><h2 id="phones-title">Phones</h2>
    ${phones.length ? html`<ul class="record-phones" aria-label="Phones">${repeat(phones, ({ number }) => number, (phone) => phoneCard(view, recording, phone))}</ul>`
    : html`<p class="quiet">No phone has joined yet. Two see people in three dimensions, four around them see them well.</p>`}</section>`;
}
