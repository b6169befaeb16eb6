// The phone of a recording: its camera, its clock, what it records when the host says so, and what it sends.

import { PHONE } from "../../shared/strings/phone.js";
import { RECORD } from "../../shared/strings/record.js";
import { ServerClock } from "../service_clock.js";
import { cleanName, RoomConnection } from "../room.js";
import { adjust, cameraProblem, trackFacts, holdStill, LivePictures, openCamera, PreviewFrames, release, Thumbnails } from "./camera.js";
import { describeDevice, keepIdentity, readBattery, readFreeBytes, WakeLock } from "./identity.js";
import { fileMessage, findLosses, stoppedMessage, TakeJournal } from "./journal.js";
import { ClipSender } from "./sender.js";
import { recordableTypes, TakeRecorder } from "./take_recorder.js";

const FIRST_SETTINGS = { width: 1920, height: 1080, frame_rate_hz: 30 };
const STATUS_MS = 1000;
const [PING_MS, FIRST_PING_MS, NUM_FIRST_PINGS] = [2000, 120, 12];
const DRAW_MS = 500;
const AGAIN_MS = 3000;
const AHEAD_S = 0.3; // of a part that begins in the middle of a take
const LINK_CODES = ["link_unknown", "recording_link_ended"];
const MAX_ERROR = 100; // characters of what the host sees

const nowS = () => performance.now() / 1000;
const problemOf = ([message, hint]) => ({ message, hint });

/** The phone. It tells by the event `change` that something is to be drawn again. */
export class PhoneCamera extends EventTarget {
  #journal = new TakeJournal();
  #wake = null;
  #timers = [];
  #thumbnails = null;
  #pictures = null; // for a live capture
  #changedAt = 0;
  clock = new ServerClock();
  room = null;
  stream = null;
  frames = null;
  recorder = null; // of the part that is recorded now
  isStopping = false;
  takes = new Map(); // as the service offers them, by number
  parts = []; // that are on the phone
  held = []; // what of the camera is held still
  welcome = null;
  problem = null; // what is wrong, for the phone's user
  refusal = null; // why the service refused the last connection; it is asked again
  end = null; // why the recording is over for this phone
  surroundings = {};

  constructor(identity, video) {
    super();
    this.identity = identity;
    this.video = video;
    video.addEventListener("resize", () => this.#resized());
    this.sender = new ClipSender({
      journal: this.#journal,
      headers: () => ({ Authorization: `Bearer ${identity.secret}`, "Multicap-Phone": identity.phoneId }),
      changed: () => this.#changed(),
      sent: (part, id) => this.#sent(part, id),
    });
  }

  get name() {
    return this.welcome?.name ?? this.identity.name;
  }

  get track() {
    return this.stream?.getVideoTracks()[0] ?? null;
  }

  get state() {
    if (this.problem) return "failed";
    if (this.recorder) return this.isStopping ? "stopping" : "recording";
    if (document.hidden) return "hidden";
    if (this.#pictures) return "live";
    if (this.sender.progress) return "sending";
    return this.track ? "ready" : "idle";
  }

  /** Bytes of the phone's parts that the service does not have yet. */
  get pendingBytes() {
    return this.parts.reduce((sum, { numBytes, uploadId }) => sum + (uploadId === null ? numBytes : 0), 0);
  }

  /** Join the recording, first without a camera: what is on the phone is sent. */
  async join() {
    keepIdentity(this.identity);
    navigator.storage.persist?.().catch(() => null); // some browsers ask their user, who need not answer
    await this.#readParts();
    this.room = new RoomConnection(this.identity.recording, this.identity.secret);
    this.room.addEventListener("open", () => this.#hello());
    this.room.addEventListener("message", ({ detail }) => this.#take(detail));
    this.room.addEventListener("away", () => this.#changed());
    const ping = () => {
      this.room.send({ type: "ping", t0_s: nowS() });
      this.#timers[1] = setTimeout(ping, this.clock.numSamples < NUM_FIRST_PINGS ? FIRST_PING_MS : PING_MS);
    };
    this.#timers = [setInterval(() => this.#status(), STATUS_MS), setTimeout(ping, FIRST_PING_MS)]; // and the next try
    document.addEventListener("visibilitychange", () => this.#status());
  }

  /** Open the camera; `problem` says why it can't be. */
  async openCamera() {
    try {
      this.stream = await openCamera(FIRST_SETTINGS, this.identity.facing);
    } catch (error) {
      this.problem = cameraProblem(error);
      this.#changed();
      return;
    }
    this.problem = recordableTypes().length ? null : problemOf(PHONE.noRecorder);
    this.track.addEventListener("ended", () => this.#cameraGone());
    this.video.srcObject = this.stream;
    this.video.play().catch(() => null);
    this.frames = new PreviewFrames(this.video);
    this.#thumbnails = new Thumbnails(this.video, this.frames, (blob) => this.room.sendPicture(blob));
    this.#wake ??= new WakeLock();
    this.room.again(); // the service learns of the camera by the first message
    this.#changed();
  }

  rename(name) {
    this.identity.name = name;
    keepIdentity(this.identity);
    if (this.welcome) this.welcome.name = name;
    this.room.send({ type: "rename", name });
    this.#changed();
  }

  /** Turn to the other camera, the front or the back one. */
  async turn() {
    if (this.recorder) return;
    this.identity.facing = this.identity.facing === "user" ? "environment" : "user";
    keepIdentity(this.identity);
    this.#closeCamera();
    await this.openCamera();
  }

  /** Remove parts that no host asks for any more, such as parts of earlier recordings. */
  async remove(parts) {
    for (const { key } of parts) await this.#remove(key);
    await this.#readParts();
    this.#changed();
  }

  #hello() {
    const { phoneId, name } = this.identity;
    const facts = this.track ? trackFacts(this.track) : {};
    this.room.send({ type: "hello", phone_id: phoneId, ...(name && { name }), device: describeDevice(navigator.userAgent), ...facts, mime_types: recordableTypes() });
  }

  async #take(message) {
    const { type } = message;
    if (type === "pong") this.clock.add(message.t0_s, message.server_s, nowS());
    else if (type === "welcome") await this.#welcomed(message);
    else if (type === "start") await this.#begin(message.take, message.at_server_s, message);
    else if (type === "stop") await this.#stop(message.take, message.at_server_s);
    else if (type === "live") await this.#live(message);
    else if (type === "rename") this.#named(message.name);
    else if (type === "upload") this.#wanted(message.take);
    else if (type === "delete") await this.#delete(message.take);
    else if (type === "ended") this.#over(message.reason);
    else if (type === "problem") this.#refused(message);
    this.#changed();
  }

  // A link that has ended is the end. Other refusals may pass, such as an outage: recording continues meanwhile.
  #refused({ code, detail, hint, close_code: closeCode, retryable }) {
    if (closeCode === null) {
      // A message that was not taken, such as that an upload is complete: after the next welcome all is told again.
      if (retryable) this.#timers[2] ??= setTimeout(() => { this.#timers[2] = undefined; this.room.again(); }, AGAIN_MS);
    } else if (LINK_CODES.includes(code)) this.#over("link");
    else this.refusal = { message: detail, hint };
  }

  async #welcomed(message) {
    this.welcome = message;
    this.refusal = null;
    this.#stopPictures(); // the service asks again for what it wants
    this.#named(message.name);
    this.takes = new Map(message.takes.map((take) => [take.number, take]));
    for (const take of message.takes) {
      const own = this.#takeParts(take.number);
      if (take.state === "used" || take.state === "discarded") await this.#delete(take.number);
      else if (take.state === "recording") await this.#goOn(take);
      else if (own.length) {
        if (this.recorder?.take === take.number) await this.#stop(take.number, take.stop_s);
        this.#tellStopped(take.number);
        // Messages that were sent while the connection was lost. Of a part that was sent again the service may know the upload before.
        for (const part of own) if (part.uploadId !== null && (part.isAgain || !take.parts.includes(part.part))) this.#tellSent(part, part.uploadId);
        if (take.is_upload_wanted) this.#wanted(take.number);
      }
    }
  }

  // A take is being recorded: this phone was reloaded, or came late.
  async #goOn({ number, start_s: startS, stop_s: stopS, settings }) {
    if (this.recorder || !this.track) return;
    await this.#begin(number, startS, { latest_stop_s: stopS, settings });
  }

  async #begin(number, atServerS, { name = RECORD.takeDefault(number), latest_stop_s: stopS, settings }) {
    this.takes.set(number, { parts: [], is_upload_wanted: false, ...this.takes.get(number), number, name, state: "recording", start_s: atServerS, stop_s: stopS });
    if (this.recorder || !this.track) return;
    while (!this.clock.isKnown) await new Promise((resolve) => { setTimeout(resolve, FIRST_PING_MS); });
    const recorder = new TakeRecorder({ stream: this.stream, frames: this.frames, clock: this.clock, journal: this.#journal }, {
      recording: this.identity.recording, take: number, part: (this.#takeParts(number).at(-1)?.part ?? 0) + 1,
    });
    Object.assign(this, { recorder, isStopping: false });
    this.#changed();
    if (settings) await adjust(this.track, settings);
    this.held = await holdStill(this.track);
    recorder.isUpright = this.#isUpright;
    const started = await recorder.start(Math.max(atServerS, this.clock.serverS(nowS()) + AHEAD_S)).catch((problem) => { recorder.problem = problem; return null; });
    if (started) {
      this.room.send({ type: "started", take: number, part: recorder.part, ...started, track: trackFacts(this.track).track });
      await this.#readParts();
      recorder.whenEnded().finally(() => this.#ended(recorder));
    } else {
      await this.#journal.remove(recorder.key);
      await this.#ended(recorder);
    }
  }

  async #stop(number, atServerS) {
    const take = this.takes.get(number);
    if (take) Object.assign(take, { state: "recorded", stop_s: atServerS });
    if (this.recorder?.take !== number) return;
    this.isStopping = true;
    this.recorder.stop(atServerS);
  }

  async #ended(recorder) {
    if (this.recorder === recorder) this.recorder = null;
    this.isStopping = false;
    if (recorder.problem) this.problem = problemOf([PHONE.stopped(recorder.problem.message), PHONE.stoppedHint]);
    await this.#readParts();
    if (this.track && !this.#pictures) release(this.track);
    if (recorder.isTurned) this.room.again(); // the service answers with the take, and another part begins
    else if (this.#takeParts(recorder.take).length) {
      this.#tellStopped(recorder.take);
      if (this.takes.get(recorder.take)?.is_upload_wanted) this.#wanted(recorder.take);
    }
    this.#changed();
  }

  // A live capture takes this phone's pictures from now on, or no longer. The camera shows what it was calibrated with.
  async #live({ is_on: isOn, size_px: sizePx }) {
    this.#stopPictures();
    const { track, clock } = this;
    if (isOn && track) {
      const { picture_bytes: maxBytes, pictures_per_s: rateHz } = this.welcome.limits;
      this.#pictures = new LivePictures(this.video, this.frames, { rateHz, maxBytes, clock, isBusy: () => this.recorder !== null, send: (packet) => this.room.sendPicture(packet) });
    }
    if (!track || this.recorder) return; // the take has settings of its own
    if (!isOn) return release(track);
    if (sizePx) await adjust(track, { ...FIRST_SETTINGS, width: sizePx[0], height: sizePx[1] });
    this.held = await holdStill(track);
  }

  #stopPictures() {
    this.#pictures?.stop();
    this.#pictures = null;
  }

  get #isUpright() {
    return this.video.videoHeight > this.video.videoWidth;
  }

  // A file has pictures of one size: of a phone that is turned while it records, browsers squeeze them.
  #resized() {
    const { recorder } = this;
    if (!recorder || this.isStopping || recorder.isUpright === undefined || recorder.isUpright === this.#isUpright) return;
    recorder.isTurned = true;
    recorder.stop(0);
  }

  #wanted(number) {
    const take = this.takes.get(number);
    if (take) take.is_upload_wanted = true;
    for (const part of this.#takeParts(number).filter(({ isOpen, numBytes }) => !isOpen && numBytes > 0)) {
      if (part.uploadId === null) this.sender.add(part);
      else this.#sendAgain(part);
    }
  }

  // Send a part again whose upload is gone: it expired, or the service was restored from a backup.
  async #sendAgain({ key, uploadId }) {
    if (await this.sender.isKept({ uploadId })) return;
    await this.#journal.note(key, "gone");
    await this.#readParts();
    const part = this.parts.find((other) => other.key === key);
    if (part?.uploadId === null) this.sender.add(part);
  }

  async #delete(number) {
    this.takes.delete(number);
    for (const { key } of this.#takeParts(number)) await this.#remove(key);
    await this.#readParts();
  }

  async #remove(key) {
    this.sender.drop(key);
    await this.#journal.remove(key);
  }

  async #sent(part, id) {
    await this.#readParts();
    this.#tellSent(part, id);
    this.#changed();
  }

  #tellSent(part, id) {
    const losses = findLosses(this.#takeParts(part.take), this.takes.get(part.take)?.stop_s ?? null);
    this.room.send(fileMessage(part, id, losses.get(part.key) ?? []));
  }

  #tellStopped(number) {
    const parts = this.#takeParts(number).filter(({ isOpen }) => !isOpen);
    this.room.send(stoppedMessage(number, parts, this.findLosses(number)));
  }

  /** Times of a take without pictures, by the keys of the parts before them. */
  findLosses(number) {
    const take = this.takes.get(number);
    return findLosses(this.#takeParts(number), take && take.state !== "recording" ? take.stop_s : null);
  }

  #takeParts(number) {
    return this.parts.filter(({ recording, take }) => recording === this.identity.recording && take === number);
  }

  async #readParts() {
    this.parts = await this.#journal.parts();
  }

  #named(name) {
    if (this.welcome) this.welcome.name = name;
    if (this.identity.name === name) return;
    this.identity.name = name;
    keepIdentity(this.identity);
  }

  #over(reason) {
    this.end = reason;
    this.room.close();
    for (const timer of this.#timers) clearInterval(timer);
    this.recorder?.stop(0);
    this.#closeCamera();
    this.#wake?.close();
  }

  // Another app took the camera, such as a call: what was recorded so far is a part.
  #cameraGone() {
    this.#closeCamera();
    this.problem = problemOf(PHONE.cameraTaken);
    this.#changed();
  }

  #closeCamera() {
    this.#thumbnails?.stop();
    this.#stopPictures();
    this.frames?.close();
    for (const track of this.stream?.getTracks() ?? []) track.stop();
    this.stream = this.frames = this.#thumbnails = null;
    this.video.srcObject = null;
  }

  async #status() {
    this.surroundings = { ...await readBattery(), free_bytes: await readFreeBytes() };
    const clock = this.clock.report(nowS());
    const take = this.takes.get(this.recorder?.take);
    const trouble = this.problem ?? this.sender.problem;
    // No host stopped it, or the stop did not come through.
    if (take && !this.isStopping && this.clock.serverS(nowS()) > take.stop_s) this.#stop(take.number, take.stop_s);
    this.room.send({
      type: "status", state: this.state, ...(this.track && { track: trackFacts(this.track).track }), ...this.surroundings, ...(clock && { clock }),
      dropped_frames: this.recorder?.counts().dropped ?? 0, pending_bytes: this.pendingBytes,
      ...(this.sender.progress && { sending: this.sender.progress }), ...(trouble && { error: cleanName(trouble.message, MAX_ERROR) }),
    });
    this.#changed();
  }

  #changed() {
    if (performance.now() - this.#changedAt < DRAW_MS && this.recorder) return; // the recording comes first
    this.#changedAt = performance.now();
    this.dispatchEvent(new Event("change"));
  }
}
