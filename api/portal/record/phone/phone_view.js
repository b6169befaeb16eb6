// View of the phone: its own picture, what it records, what it sends.

import { clock, percent, size } from "../../shared/format.js";
import { html, nothing, problemBox, render, typed } from "../../shared/lit.js";
import { announce } from "../../shared/page.js";
import { COMMON, COUNTS } from "../../shared/strings/common.js";
import { FRAME } from "../../shared/strings/frame.js";
import { PHONE } from "../../shared/strings/phone.js";
import { RECORD } from "../../shared/strings/record.js";
import { cleanName } from "../room.js";
import { readIdentity } from "./identity.js";
import { TakeJournal } from "./journal.js";
import { PhoneCamera } from "./phone.js";

const STATE_TONES = { idle: "wait", ready: "good", live: "run", recording: "bad", stopping: "wait", sending: "run", hidden: "wait", failed: "bad" };
const TICK_MS = 250;

class PhoneView {
  #phone;
  #isNaming = false;
  #state = null;
  #isJoined = false;

  constructor(place, phone) {
    this.place = place;
    this.#phone = phone;
    phone.addEventListener("change", () => this.draw());
    setInterval(() => { if (phone.recorder) this.draw(); }, TICK_MS);
    this.draw();
  }

  async #join(event) {
    event.preventDefault();
    const phone = this.#phone;
    const name = cleanName(event.target.elements.name?.value ?? "");
    if (name) phone.identity.name = name;
    if (!this.#isJoined) await phone.join();
    this.#isJoined = true;
    await phone.openCamera();
  }

  /** Go on after the page was opened again: a phone that is known needs no touch, but for browsers that ask for the camera each time. */
  async goOn() {
    this.#isJoined = true;
    await this.#phone.join();
    const permission = await navigator.permissions?.query({ name: "camera" }).catch(() => null);
    if (permission?.state === "granted") await this.#phone.openCamera();
    this.draw();
  }

  draw() {
    const phone = this.#phone;
    const words = PHONE.states[phone.state];
    if (phone.state !== this.#state) {
      this.#state = phone.state;
      announce(words);
      document.title = FRAME.title(words);
    }
    render(phone.end ? this.#ended() : html`
      <div class="phone-picture" data-state=${phone.state} ?hidden=${!phone.track}>${phone.video}${this.#overlay()}</div>
      <div class="phone-panel">
        ${this.#head()}
        ${problemBox(phone.problem ?? phone.refusal)}
        ${phone.track ? nothing : this.#entrance()}
        ${this.#facts()}
        ${this.#takes()}
        ${this.#leftovers()}
      </div>`, this.place);
  }

  #ended() {
    const [title, text] = PHONE.ends[this.#phone.end];
    const kept = this.#phone.parts.filter(({ uploadId }) => uploadId === null);
    return html`<section class="panel entrance" role="alert"><h1>${title}</h1><p>${text}</p>
      ${kept.length ? html`<p class="quiet">${PHONE.unsent(COUNTS.clips(kept.length))}</p>` : nothing}</section>`;
  }

  #overlay() {
    const { recorder, clock: service, takes, isStopping, track } = this.#phone;
    if (!recorder) return track ? html`<p class="phone-over">${PHONE.stateHints[this.#state] ?? ""}</p>` : nothing;
    const take = takes.get(recorder.take);
    const passedS = service.serverS(performance.now() / 1000) - take.start_s;
    const words = passedS < 0 ? PHONE.startsIn(Math.ceil(-passedS)) : isStopping ? PHONE.stopping : clock(passedS);
    return html`<p class="phone-over recording"><span class="phone-dot"></span>${PHONE.running(take.name, words)}</p>`;
  }

  #head() {
    const phone = this.#phone;
    const isAway = phone.room && !phone.room.isOpen;
    return html`<div class="phone-head">
      ${this.#isNaming ? this.#nameForm() : html`<h1>${phone.welcome ? phone.name : PHONE.title}</h1>`}
      <span class="state" data-tone=${STATE_TONES[phone.state]}>${PHONE.states[phone.state]}</span>
    </div>
    ${isAway ? html`<p class="notice" role="status">${phone.recorder ? PHONE.awayRecording : PHONE.away}</p>` : nothing}`;
  }

  #nameForm() {
    const end = (event) => {
      event.preventDefault();
      const name = cleanName(event.target.elements.name.value);
      this.#isNaming = false;
      if (name) this.#phone.rename(name);
      this.draw();
    };
    return html`<form class="phone-name" @submit=${end}><input name="name" maxlength="64" aria-label=${PHONE.name} .value=${typed(this.#phone.name)} autocomplete="off"><button class="button small primary">${COMMON.save}</button></form>`;
  }

  #entrance() {
    const phone = this.#phone;
    return html`<form class="phone-entrance" @submit=${(event) => this.#join(event)}>
      ${this.#isJoined ? nothing : html`<p>${PHONE.intro}</p>
        <label class="field"><span>${PHONE.name}</span><input name="name" maxlength="64" placeholder=${PHONE.namePlaceholder} autocomplete="off" .value=${typed(phone.identity.name)}></label>`}
      <div class="actions"><button class="button primary">${PHONE.allow}</button></div>
    </form>`;
  }

  #facts() {
    const phone = this.#phone;
    if (!phone.track) return nothing;
    const { width, height, frameRate } = phone.track.getSettings();
    const { battery, charging, free_bytes: free } = phone.surroundings;
    const own = phone.clock.report(performance.now() / 1000);
    const facts = [
      `${width} × ${height}`, frameRate ? COMMON.hz(Math.round(frameRate)) : null,
      battery === undefined ? null : charging ? PHONE.charging(RECORD.battery(percent(battery))) : RECORD.battery(percent(battery)),
      free ? RECORD.freeSpace(size(free)) : null, own ? RECORD.clock(Math.max(1, Math.round(1000 * own.std_s))) : PHONE.measuringClock,
      phone.stream.getAudioTracks().length ? null : PHONE.noSound,
    ].filter(Boolean);
    return html`<p class="quiet facts">${facts.map((fact) => html`<span>${fact}</span>`)}</p>
      <div class="actions">
        <button type="button" class="button small" @click=${() => { this.#isNaming = true; this.draw(); this.place.querySelector("[name=name]").select(); }}>${COMMON.rename}</button>
        <button type="button" class="button small" ?disabled=${phone.recorder !== null} @click=${() => phone.turn()}>${PHONE.otherCamera}</button>
      </div>
      <p class="quiet">${PHONE.hint}</p>`;
  }

  #takes() {
    const phone = this.#phone;
    const own = phone.parts.filter(({ recording, isOpen, numBytes }) => recording === phone.identity.recording && !isOpen && numBytes > 0);
    if (own.length === 0) return nothing;
    const numbers = [...new Set(own.map(({ take }) => take))];
    return html`<h2>${PHONE.onThisPhone}</h2><ul class="phone-takes" aria-label=${PHONE.onThisPhone}>${numbers.map((number) => this.#take(number, own.filter(({ take }) => take === number)))}</ul>`;
  }

  #take(number, parts) {
    const phone = this.#phone;
    const take = phone.takes.get(number);
    const bytes = parts.reduce((sum, { numBytes }) => sum + numBytes, 0);
    const lasts = parts.reduce((sum, { durationS }) => sum + durationS, 0);
    const { progress, problem } = phone.sender;
    const isSending = progress?.take === number;
    const isSent = parts.every(({ uploadId }) => uploadId !== null);
    const states = PHONE.sendStates;
    const waits = problem ? states.waitsFor(problem.message) : states.waits;
    const share = isSending && RECORD.clipStates.sent(percent(progress.sent_bytes / progress.num_bytes));
    const words = isSent ? states.sent : share || (take?.is_upload_wanted ? waits : states.notAsked);
    const name = take?.name ?? RECORD.takeDefault(number);
    const lostS = [...phone.findLosses(number).values()].flat().reduce((sum, { from_s: from, to_s: to }) => sum + to - from, 0);
    return html`<li><b>${name}</b> <span class="quiet">${PHONE.clipFacts(clock(lasts), size(bytes), words)}</span>
      ${lostS > 0 ? html`<span class="phone-lost">${RECORD.lost(lostS.toFixed(1))}</span>` : nothing}
      ${isSending ? html`<progress max=${progress.num_bytes} value=${progress.sent_bytes} aria-label=${PHONE.sendingOf(name)}></progress>` : nothing}</li>`;
  }

  // Parts of earlier recordings, which are asked for no more.
  #leftovers() {
    const phone = this.#phone;
    const others = phone.parts.filter(({ recording }) => recording !== phone.identity.recording);
    if (others.length === 0) return nothing;
    const bytes = others.reduce((sum, { numBytes }) => sum + numBytes, 0);
    return html`<p class="quiet">${PHONE.earlier(COUNTS.clips(others.length), size(bytes))}
      <button type="button" class="button small" @click=${() => phone.remove(others)}>${PHONE.delete}</button></p>`;
  }
}

export async function open(place) {
  const identity = isSecureContext ? readIdentity(location.hash) : null;
  const refuse = ([title, text]) => render(html`<section class="panel entrance" role="alert"><h1>${title}</h1><p>${text}</p></section>`, place);
  if (!isSecureContext) return refuse(PHONE.insecure);
  if (identity === null) return refuse(PHONE.noLink);
  if (!await TakeJournal.isOffered()) return refuse(PHONE.noStorage);
  addEventListener("hashchange", () => location.reload());
  const video = Object.assign(document.createElement("video"), { muted: true, playsInline: true, ariaLabel: PHONE.picture });
  place.replaceChildren();
  const view = new PhoneView(place, new PhoneCamera(identity, video));
  if (identity.isKnown) await view.goOn();
  return view;
}
