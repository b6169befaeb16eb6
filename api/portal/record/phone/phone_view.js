// View of the phone: its own picture, what it records, what it sends.

import { clock, count, percent, size } from "../../shared/format.js";
import { html, nothing, problemBox, render, typed } from "../../shared/lit.js";
import { announce } from "../../shared/page.js";
import { cleanName } from "../room.js";
import { readIdentity } from "./identity.js";
import { TakeJournal } from "./journal.js";
import { PhoneCamera } from "./phone.js";

const STATES = {
  idle: ["No camera", "wait"], ready: ["Ready", "good"], recording: ["Recording", "bad"], stopping: ["Stopping", "wait"], sending: ["Sending", "run"],
  hidden: ["Hidden", "wait"], failed: ["Trouble", "bad"],
};
const ENDS = {
  recording: ["The recording is over", "The host has ended it, or its time is over."],
  removed: ["The host has removed this phone", "Ask the host for a new link."],
  replaced: ["This phone is open in another tab", "Go on there, or close it and reload this page."],
  link: ["This link has ended", "Ask the host for a new link."],
};
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
    const [words] = STATES[phone.state];
    if (phone.state !== this.#state) {
      this.#state = phone.state;
      announce(words);
      document.title = `${words} · Multicap`;
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
    const [title, text] = ENDS[this.#phone.end];
    const kept = this.#phone.parts.filter(({ uploadId }) => uploadId === null);
    return html`<section class="panel entrance" role="alert"><h1>${title}</h1><p>${text}</p>
      ${kept.length ? html`<p class="quiet">${count(kept.length, "clip")} that was not sent is still on this phone.</p>` : nothing}</section>`;
  }

  #overlay() {
    const { recorder, clock: service, takes, isStopping, track } = this.#phone;
    if (!recorder) return track ? html`<p class="phone-over">${this.#state === "ready" ? "Ready. The host starts the take." : ""}</p>` : nothing;
    const take = takes.get(recorder.take);
    const passedS = service.serverS(performance.now() / 1000) - take.start_s;
    const words = passedS < 0 ? `starts in ${Math.ceil(-passedS)}` : isStopping ? "stopping" : clock(passedS);
    return html`<p class="phone-over recording"><span class="phone-dot"></span>${take.name} · ${words}</p>`;
  }

  #head() {
    const phone = this.#phone;
    const [words, tone] = STATES[phone.state];
    const isAway = phone.room && !phone.room.isOpen;
    return html`<div class="phone-head">
      ${this.#isNaming ? this.#nameForm() : html`<h1>${phone.welcome ? phone.name : "Phone as a camera"}</h1>`}
      <span class="state" data-tone=${tone}>${words}</span>
    </div>
    ${isAway ? html`<p class="notice" role="status">The service does not answer. ${phone.recorder ? "The recording goes on." : "It is asked again until it does."}</p>` : nothing}`;
  }

  #nameForm() {
    const end = (event) => {
      event.preventDefault();
      const name = cleanName(event.target.elements.name.value);
      this.#isNaming = false;
      if (name) this.#phone.rename(name);
      this.draw();
    };
    return html`<form class="phone-name" @submit=${end}><input name="name" maxlength="64" aria-label="Name of this phone" .value=${typed(this.#phone.name)} autocomplete="off"><button class="button small primary">Save</button></form>`;
  }

  #entrance() {
    const phone = this.#phone;
    return html`<form class="phone-entrance" @submit=${(event) => this.#join(event)}>
      ${this.#isJoined ? nothing : html`<p>This phone becomes a camera of a recording. The host starts and stops it, and the video goes to the host's service alone.</p>
        <label class="field"><span>Name of this phone</span><input name="name" maxlength="64" placeholder="left, window, Anna's phone" autocomplete="off" .value=${typed(phone.identity.name)}></label>`}
      <div class="actions"><button class="button primary">Allow the camera</button></div>
    </form>`;
  }

  #facts() {
    const phone = this.#phone;
    if (!phone.track) return nothing;
    const { width, height, frameRate } = phone.track.getSettings();
    const { battery, charging, free_bytes: free } = phone.surroundings;
    const own = phone.clock.report(performance.now() / 1000);
    const facts = [
      `${width} × ${height}`, frameRate ? `${Math.round(frameRate)} Hz` : null,
      battery === undefined ? null : `battery ${percent(battery)}${charging ? ", charging" : ""}`,
      free ? `${size(free)} free` : null, own ? `clock ± ${Math.max(1, Math.round(1000 * own.std_s))} ms` : "measuring the clock",
      phone.stream.getAudioTracks().length ? null : "no sound",
    ].filter(Boolean);
    return html`<p class="quiet facts">${facts.map((fact) => html`<span>${fact}</span>`)}</p>
      <div class="actions">
        <button type="button" class="button small" @click=${() => { this.#isNaming = true; this.draw(); this.place.querySelector("[name=name]").select(); }}>Rename</button>
        <button type="button" class="button small" ?disabled=${phone.recorder !== null} @click=${() => phone.turn()}>Other camera</button>
      </div>
      <p class="quiet">Keep this page open and in front, and let nobody touch the phone: put it on a stand or a shelf, lying on its long side.</p>`;
  }

  #takes() {
    const phone = this.#phone;
    const own = phone.parts.filter(({ recording, isOpen, numBytes }) => recording === phone.identity.recording && !isOpen && numBytes > 0);
    if (own.length === 0) return nothing;
    const numbers = [...new Set(own.map(({ take }) => take))];
    return html`<h2>On this phone</h2><ul class="phone-takes" aria-label="On this phone">${numbers.map((number) => this.#take(number, own.filter(({ take }) => take === number)))}</ul>`;
  }

  #take(number, parts) {
    const phone = this.#phone;
    const take = phone.takes.get(number);
    const bytes = parts.reduce((sum, { numBytes }) => sum + numBytes, 0);
    const lasts = parts.reduce((sum, { durationS }) => sum + durationS, 0);
    const { progress, problem } = phone.sender;
    const isSending = progress?.take === number;
    const isSent = parts.every(({ uploadId }) => uploadId !== null);
    const words = isSent ? "sent" : isSending ? `${percent(progress.sent_bytes / progress.num_bytes)} sent` : take?.is_upload_wanted ? (problem ? `waits: ${problem.message}` : "waits") : "the host has not asked for it yet";
    const lostS = [...phone.findLosses(number).values()].flat().reduce((sum, { from_s: from, to_s: to }) => sum + to - from, 0);
    return html`<li><b>${take?.name ?? `Take ${number}`}</b> <span class="quiet">${clock(lasts)} · ${size(bytes)} · ${words}</span>
      ${lostS > 0 ? html`<span class="phone-lost">${lostS.toFixed(1)} s lost</span>` : nothing}
      ${isSending ? html`<progress max=${progress.num_bytes} value=${progress.sent_bytes} aria-label="Sending ${take?.name ?? number}"></progress>` : nothing}</li>`;
  }

  // Parts of earlier recordings, which nobody asks for any more.
  #leftovers() {
    const phone = this.#phone;
    const others = phone.parts.filter(({ recording }) => recording !== phone.identity.recording);
    if (others.length === 0) return nothing;
    const bytes = others.reduce((sum, { numBytes }) => sum + numBytes, 0);
    return html`<p class="quiet">${count(others.length, "clip")} of earlier recordings, ${size(bytes)}, ${others.length === 1 ? "is" : "are"} still on this phone.
      <button type="button" class="button small" @click=${() => phone.remove(others)}>Delete</button></p>`;
  }
}

export async function open(place) {
  const identity = isSecureContext ? readIdentity(location.hash) : null;
  const refuse = (title, text) => render(html`<section class="panel entrance" role="alert"><h1>${title}</h1><p>${text}</p></section>`, place);
  if (!isSecureContext) return refuse("This page needs an encrypted connection", "Browsers give the camera to addresses that begin with https alone. Open the link of the host again, or ask the host to start the service with --https.");
  if (identity === null) return refuse("This address has no link", "Scan the code that the host shows, or open the host's link.");
  if (!await TakeJournal.isOffered()) return refuse("This window keeps nothing", "Leave the private mode of the browser, and open the link again.");
  addEventListener("hashchange", () => location.reload());
  const video = Object.assign(document.createElement("video"), { muted: true, playsInline: true, ariaLabel: "Picture of this phone's camera" });
  place.replaceChildren();
  const view = new PhoneView(place, new PhoneCamera(identity, video));
  if (identity.isKnown) await view.goOn();
  return view;
}
