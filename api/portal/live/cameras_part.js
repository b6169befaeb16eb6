// Part of the view Live with the cameras that the service opens: addresses of streams, and cameras of its machine.

import { call } from "../shared/api.js";
import { helpLink, html, live, nothing, problemBox, selectField, typed } from "../shared/lit.js";
import { readOptions } from "../shared/resources.js";
import { COMMON } from "../shared/strings/common.js";
import { LIVE } from "../shared/strings/live.js";

const TEXT = LIVE.cameras;
const [SYNC_S, SCHEME] = [10, "rtsp://"];

/** Phones of a recording as sources of cameras. */
const phonesOf = ({ id, phones }) => phones.filter(({ is_removed: isRemoved }) => !isRemoved).map(({ number, name }) => ({ name, source: `phone://${id}/${number}` }));

/** Chosen cameras of a capture; `changed` is called after each change from elsewhere. */
export class ChosenCameras {
  rows = []; // { name, source }
  devices = null; // answer of the service, once it is there
  profiles = []; // { name, label }
  profile = "fast";
  isMeasured = false; // true: offsets of the cameras are measured
  problem = null;
  isNew = false; // true: these cameras are to be calibrated, and get their names here
  durationS = 20; // of the recording from which they are calibrated
  recordings = []; // that have phones
  recording = null; // the chosen one, whose phones are cameras
  #names = ""; // of the calibration whose cameras are listed

  constructor(changed) {
    this.changed = changed;
  }

  async load() {
    try {
      const [devices, { choices }, { recordings }] = await Promise.all([call("/v1/live/devices"), readOptions(), call("/v1/recordings")]);
      Object.assign(this, { devices, profiles: choices.find(({ name }) => name === "profile").values, recordings: recordings.filter((recording) => phonesOf(recording).length), problem: null });
    } catch (problem) {
      this.problem = problem;
    }
    this.changed();
  }

  /** List the cameras of a calibration; sources that were typed stay with their names. */
  list(names) {
    this.isNew = false;
    if (names.join("\n") === this.#names) return;
    this.#names = names.join("\n");
    const typedSources = new Map(this.rows.map(({ name, source }) => [name, source]));
    this.rows = names.map((name) => ({ name, source: typedSources.get(name) ?? "" }));
    this.#takePhones();
  }

  // Phones of the chosen recording become the cameras of their names; of a calibration that is to be made, all of them.
  #takePhones() {
    if (!this.recording) return;
    const sources = new Map(phonesOf(this.recording).map(({ name, source }) => [name, source]));
    if (this.isNew) this.rows = [...sources].map(([name, source]) => ({ name, source }));
    else for (const row of this.rows) row.source = sources.get(row.name) ?? row.source;
  }

  /** Let the cameras be named, for a calibration that is to be made. */
  rename() {
    this.isNew = true;
    this.#names = "";
    this.#takePhones();
    while (this.rows.length < 2) this.add();
  }

  add() { this.rows.push({ name: `cam_${this.rows.length + 1}`, source: "" }); }

  get used() { return this.rows.map(({ name, source }) => ({ camera: name.trim(), source: source.trim() })).filter(({ source }) => source !== ""); }

  /** Sentences about missing facts. */
  get faults() {
    const names = new Set(this.used.map(({ camera }) => camera));
    return [...(this.used.length < 2 ? [LIVE.faults.cameras] : []), ...(names.size < this.used.length || names.has("") ? [LIVE.faults.names] : []),
      ...(this.isNew && !(this.durationS >= 1 && this.durationS <= 60) ? [LIVE.faults.duration] : [])];
  }

  /** Fields of the message `start_cameras`. */
  get start() {
    return { type: "start_cameras", cameras: this.used, profile: this.profile, sync_s: this.isMeasured ? SYNC_S : null };
  }

  part(isLocked) {
    const { allows_private: allowsPrivate = true, devices = [] } = this.devices ?? {};
    return html`<section class="panel" aria-labelledby="sources-title"><div class="with-help"><h2 id="sources-title">${COMMON.cameras}</h2>${helpLink("live", COMMON.cameras)}</div>
      <p class="quiet" id="sources-hint">${this.rows.length ? TEXT.hint : TEXT.noCalibration} ${this.devices === null ? nothing : allowsPrivate ? TEXT.devices(devices.length) : TEXT.publicOnly}</p>
      ${problemBox(this.problem)}
      ${this.recordings.length ? html`${selectField(TEXT.phones, [["", TEXT.noPhones], ...this.recordings.map(({ id, name }) => [id, name])], { chosen: this.recording?.id, choose: (id) => { this.recording = this.recordings.find((one) => one.id === id) ?? null; this.#takePhones(); this.changed(); }, isOff: isLocked })}
        ${this.recording ? html`<p class="quiet">${TEXT.phonesHint}</p>` : nothing}` : nothing}
      ${this.rows.map((row, place) => this.#row(row, place, isLocked))}
      <datalist id="live-devices">${devices.map(({ device, name }) => html`<option value=${device}>${name}</option>`)}
        ${this.recordings.flatMap((recording) => phonesOf(recording).map(({ name, source }) => html`<option value=${source}>${TEXT.phoneOf(name, recording.name)}</option>`))}</datalist>
      ${this.isNew ? this.#recordingFields(isLocked) : this.#captureFields(isLocked)}
    </section>`;
  }

  #row(row, place, isLocked) {
    const source = html`<input type="text" inputmode="url" maxlength="2000" autocomplete="off" autocapitalize="off" spellcheck="false" list="live-devices" placeholder=${SCHEME}
      aria-label=${TEXT.address(row.name)} aria-describedby="sources-hint" .value=${typed(row.source)} ?disabled=${isLocked} @input=${(event) => { row.source = event.target.value; }}>`;
    if (!this.isNew) return html`<div class="field live-source"><span>${row.name}</span>${source}</div>`;
    return html`<div class="live-source named"><input type="text" maxlength="100" autocomplete="off" spellcheck="false" aria-label=${TEXT.name(place + 1)}
      .value=${typed(row.name)} ?disabled=${isLocked} @input=${(event) => { row.name = event.target.value; this.changed(); }}>${source}</div>`;
  }

  #recordingFields(isLocked) {
    return html`<p class="quiet">${TEXT.recordHint}</p><div class="actions">
      <button type="button" class="button small" ?disabled=${isLocked} @click=${() => { this.add(); this.changed(); }}>${TEXT.add}</button>
      <label class="with">${TEXT.duration} <input class="number" type="number" min="1" max="60" step="any" .value=${typed(this.durationS)} ?disabled=${isLocked} @input=${(event) => { this.durationS = event.target.valueAsNumber; }}></label></div>`;
  }

  #captureFields(isLocked) {
    return html`${selectField(TEXT.profile, this.profiles.map(({ name, label }) => [name, label]), { chosen: this.profile, choose: (name) => { this.profile = name; }, isOff: isLocked })}
      <label class="with"><input type="checkbox" .checked=${live(this.isMeasured)} ?disabled=${isLocked} @change=${(event) => { this.isMeasured = event.target.checked; }}> ${TEXT.measure(SYNC_S)}</label>`;
  }
}
