// View of one recording as its host sees it.

import { call, persistently } from "../../shared/api.js";
import { feed } from "../../shared/feed.js";
import { moment } from "../../shared/format.js";
import { confirm, helpLink, html, nothing, problemBox, prose, render, repeat } from "../../shared/lit.js";
import { announce, go } from "../../shared/page.js";
import { readCalibrations, readOptions, usable } from "../../shared/resources.js";
import { COMMON } from "../../shared/strings/common.js";
import { RECORD } from "../../shared/strings/record.js";
import { sending } from "../../send/sending.js";
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
  spec = sending.draft.spec; // choices of the next jobs: the last ones of this browser
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
    announce(RECORD.calibrationChosen);
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
    if (!await confirm({ title: RECORD.deleting.title(name), text: RECORD.deleting.text, action: RECORD.delete })) return;
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
      render(html`<h1 class="title">${RECORD.title}</h1>${problem ? problemBox(problem) : html`<p class="quiet">${COMMON.loading}</p>`}<p><a href="#/record">${RECORD.all}</a></p>`, this.place);
      return;
    }
    render(html`<div class="bar"><div class="with-help"><h1 class="title">${state.recording.name}</h1>${helpLink("phones", RECORD.title)}</div><a href="#/record">${RECORD.all}</a>
        <button type="button" class="button small danger-quiet record-delete" @click=${() => this.#remove()}>${RECORD.delete}</button></div>
      ${problemBox(problem)}
      ${recording.isConnected ? nothing : html`<p class="notice" role="status">${RECORD.away}</p>`}
      ${state.relay === "away" ? html`<p class="notice" role="status">${RECORD.relayAway}</p>` : nothing}
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
    if (join && !await confirm(RECORD.renewing)) return;
    await recording.renewJoin();
  };
  return html`<section class="panel record-join" aria-labelledby="join-title"><h2 id="join-title">${RECORD.join}</h2>
    ${join ? html`<img class="record-code" alt=${RECORD.code} src=${`data:image/svg+xml,${encodeURIComponent(join.qr_svg)}`}>
      <a class="record-link" href=${join.url} target="_blank" rel="noopener">${join.url}</a>
      ${isOfThisMachine(join.url) ? html`<p class="notice" role="status">${prose(RECORD.localOnly)}</p>` : nothing}
      <p class="quiet">${RECORD.joinHint(moment(join.expires_at))}</p>`
    : html`<p class="quiet">${RECORD.joinGone}</p>`}
    <div class="actions"><button type="button" class="button small" @click=${renew}>${RECORD.newLink}</button></div></section>`;
}

function phoneCard(view, recording, phone) {
  const { number, name, device, live } = phone;
  const [words, tone] = phoneState(live);
  const picture = recording.pictures.get(number);
  const remove = async () => {
    const { title, text, action } = RECORD.removing;
    if (await confirm({ title: title(name), text, action })) recording.send({ type: "remove", phone: number });
  };
  const rename = (event) => {
    event.preventDefault();
    const wanted = cleanName(event.target.elements.name.value);
    view.renamed = null;
    if (wanted && wanted !== name) recording.send({ type: "rename", phone: number, name: wanted });
    view.draw();
  };
  return html`<li class="record-phone" data-tone=${tone}>
    <div class="record-picture">${picture && live?.is_connected ? html`<img src=${picture} alt=${RECORD.pictureOf(name)}>` : html`<span class="quiet">${RECORD.noPicture}</span>`}</div>
    <div class="head">${view.renamed === number
    ? html`<form class="rename" @submit=${rename}><input name="name" maxlength="64" required aria-label=${COMMON.newName(name)} value=${name} autocomplete="off"><button class="button small primary">${COMMON.save}</button></form>`
    : html`<h3>${name}</h3>`}<span class="state" data-tone=${tone}>${words}</span></div>
    <p class="quiet facts">${phoneFacts(live).map(({ text, isWorse }) => html`<span class=${isWorse ? "worse" : ""}>${text}</span>`)}</p>
    <p class="quiet">${device}</p>
    ${live?.status?.error ? html`<p class="problem">${live.status.error}</p>` : nothing}
    <div class="actions"><button type="button" class="button small" aria-label=${COMMON.renameOf(name)} @click=${() => { view.renamed = number; view.draw(); }}>${COMMON.rename}</button>
      <button type="button" class="button small danger-quiet" aria-label=${RECORD.removeOf(name)} @click=${remove}>${RECORD.remove}</button></div></li>`;
}

function phonesPart(view, recording) {
  const { phones } = recording;
  return html`<section class="panel" aria-labelledby="phones-title"><h2 id="phones-title">${RECORD.phones}</h2>
    ${phones.length ? html`<ul class="record-phones" aria-label=${RECORD.phones}>${repeat(phones, ({ number }) => number, (phone) => phoneCard(view, recording, phone))}</ul>`
    : html`<p class="quiet">${RECORD.noPhones}</p>`}</section>`;
}
