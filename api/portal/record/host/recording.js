// A recording as its host sees it: phones with their pictures, takes with their clips.

import { call, persistently } from "../../shared/api.js";
import { feed } from "../../shared/feed.js";
import { announce } from "../../shared/page.js";
import { PROBLEMS } from "../../shared/strings/common.js";
import { RECORD } from "../../shared/strings/record.js";
import { ServerClock } from "../service_clock.js";
import { keptJoin, keepJoin, RoomConnection } from "../room.js";

const PING_MS = 2000;
const HEAD_BYTES = 2; // number of the phone, before its picture
const nowS = () => performance.now() / 1000;

/** State of a recording. It tells by the event `change` that something is to be drawn again. */
export class HostedRecording extends EventTarget {
  #room = null;
  #timer = 0;
  #isClosed = false;
  #asked = new Set(); // takes whose clips were asked for
  #isRefused = false; // for now: it is asked again
  clock = new ServerClock();
  state = null; // last message `state` of the service
  warnings = new Map(); // about clips that are in no capture, by the numbers of their takes
  pictures = new Map(); // addresses of the phones' last pictures, by their numbers
  problem = null;
  sendsAtOnce = true; // whether phones are asked for each take as soon as it is recorded

  constructor(id) {
    super();
    this.id = id;
    this.join = keptJoin(id);
    this.path = `/v1/recordings/${encodeURIComponent(id)}`;
  }

  /** Load the recording, and follow it. */
  async open() {
    try {
      const away = (problem) => this.#fail(problem);
      const recording = await persistently(() => call(this.path), { isOver: () => this.#isClosed, away });
      this.state = { recording, live: [], relay: "ok" };
    } catch (problem) {
      this.#fail(problem);
      return;
    }
    if (this.#isClosed) return;
    this.problem = null;
    this.#room = new RoomConnection(this.id);
    this.#room.addEventListener("message", ({ detail }) => this.#take(detail));
    this.#room.addEventListener("bytes", ({ detail }) => this.#show(detail));
    this.#room.addEventListener("open", () => this.#ping());
    this.#room.addEventListener("away", () => this.#changed());
    this.#timer = setInterval(() => this.#ping(), PING_MS);
    this.#changed();
  }

  close() {
    this.#isClosed = true;
    clearInterval(this.#timer);
    this.#room?.close();
    for (const url of this.pictures.values()) URL.revokeObjectURL(url);
  }

  get isConnected() {
    return this.#room?.isOpen ?? false;
  }

  /** Phones that were not removed, each with what is known of it at the moment as `live`. */
  get phones() {
    const { recording, live } = this.state;
    return recording.phones.filter((phone) => !phone.is_removed).map((phone) => ({ ...phone, live: live.find(({ number }) => number === phone.number) ?? null }));
  }

  /** Takes, the newest first, without those that were discarded. */
  get takes() {
    return this.state.recording.takes.filter(({ state }) => state !== "discarded").reverse();
  }

  /** Take that is recorded now, or about to be; undefined without one. */
  get running() {
    return this.state?.recording.takes.find(({ state }) => state === "recording");
  }

  /** Time of the service in seconds; of this machine until it is measured. */
  get serverS() {
    return this.clock.isKnown ? this.clock.serverS(nowS()) : Date.now() / 1000;
  }

  /** Send a message of the host. */
  send(message) {
    this.problem = this.#room?.send(message) ? null : { message: PROBLEMS.away, hint: RECORD.phonesContinue };
    this.#changed();
  }

  /** Make another link; the one before opens nothing any more. */
  async renewJoin() {
    await this.#act(async () => {
      const { join } = await call(`${this.path}/join`, { method: "POST" });
      this.join = join;
      keepJoin(this.id, join);
      announce(RECORD.renewed);
    });
  }

  /** Make a session of a take, with its job. */
  reconstruct(take, calibrationId, job) {
    return this.#act(async () => {
      const body = { calibration_id: calibrationId, job };
      const made = await call(`${this.path}/takes/${take.number}/session`, { method: "POST", body });
      this.warnings.set(take.number, made.warnings);
      await feed.refresh();
      announce(RECORD.reconstructing(take.name));
      return made;
    });
  }

  /** Make a calibration from a take, of people with a stature or of a board. */
  calibrate(take, choices) {
    return this.#act(async () => {
      const job = await call(`${this.path}/takes/${take.number}/calibration`, { method: "POST", body: choices });
      feed.put(job);
      announce(RECORD.calibrationStarted);
      return job;
    });
  }

  async #act(action) {
    this.problem = null;
    try {
      return await action();
    } catch (problem) {
      this.problem = problem;
      return null;
    } finally {
      this.#changed();
    }
  }

  #take(message) {
    if (message.type === "pong") this.clock.add(message.t0_s, message.server_s, nowS());
    else if (message.type === "state") this.#follow(message);
    else if (message.type === "problem") this.#refuse(message);
  }

  // The service repeats the recording only if it has changed.
  #follow(state) {
    this.state = { ...state, recording: state.recording ?? this.state.recording };
    if (this.#isRefused) this.problem = null;
    this.#isRefused = false;
    const unasked = this.sendsAtOnce ? this.state.recording.takes.filter((take) => take.state === "recorded" && !take.is_upload_wanted && !this.#asked.has(take.number)) : [];
    for (const { number } of unasked) {
      this.#asked.add(number);
      this.#room.send({ type: "upload", take: number });
    }
    this.#changed();
  }

  #refuse({ detail, hint, errors = [], close_code: code, retryable }) {
    this.#isRefused = code !== null && retryable;
    this.#fail({ message: detail, hint, items: errors });
    if (code !== null && !retryable) this.#room.close();
  }

  #show(packet) {
    const number = new DataView(packet).getUint16(0, true);
    const before = this.pictures.get(number);
    this.pictures.set(number, URL.createObjectURL(new Blob([new Uint8Array(packet, HEAD_BYTES)], { type: "image/jpeg" })));
    if (before) URL.revokeObjectURL(before);
    this.#changed();
  }

  #ping() {
    this.#room.send({ type: "ping", t0_s: nowS() });
  }

  #fail(problem) {
    this.problem = problem;
    this.#changed();
  }

  #changed() {
    if (!this.#isClosed) this.dispatchEvent(new Event("change"));
  }
}
