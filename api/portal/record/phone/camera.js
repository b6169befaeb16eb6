// Camera of the phone: opened at a size and rate, its exposure, focus and white balance held still.

import { PHONE } from "../../shared/strings/phone.js";
import { cleanName } from "../room.js";

// Sound as it is: what makes calls pleasant would take the claps and beeps out that clocks are measured by.
const SOUND = { echoCancellation: false, noiseSuppression: false, autoGainControl: false };
// Modes that hold a value still, with the setting that they hold.
const HELD = [["exposureMode", "exposureTime"], ["focusMode", "focusDistance"], ["whiteBalanceMode", "colorTemperature"]];
const STILL = ["manual", "none"]; // browsers name it by one or the other
const USUAL_RATE_HZ = 30;

/** Constraints of a size and rate that a camera reaches as closely as it can. */
function videoConstraints({ width, height, frame_rate_hz: rateHz }, facing) {
  return { facingMode: facing, width: { ideal: width }, height: { ideal: height }, frameRate: { ideal: rateHz } };
}

/** Constraints that hold a camera's exposure, focus and white balance as they are, where it can; null where it can't. */
export function heldConstraints(capabilities, settings) {
  const held = HELD.map(([mode, value]) => {
    const still = STILL.find((name) => capabilities[mode]?.includes(name));
    return still ? { [mode]: still, ...(settings[value] !== undefined && { [value]: settings[value] }) } : null;
  }).filter(Boolean);
  return held.length ? { advanced: held } : null;
}

/** Camera and microphone as one stream; a phone without a microphone, or that keeps it to itself, sends no sound. */
export async function openCamera(wanted, facing = "environment") {
  const video = videoConstraints(wanted, facing);
  try {
    return await navigator.mediaDevices.getUserMedia({ video, audio: SOUND });
  } catch {
    return navigator.mediaDevices.getUserMedia({ video });
  }
}

/** Hold the camera still, but for its size and rate. Returns the names of what is held. */
export async function holdStill(track) {
  const constraints = heldConstraints(track.getCapabilities?.() ?? {}, track.getSettings());
  if (!constraints) return [];
  const held = [];
  // One by one: a camera that refuses one of them may hold the others.
  for (const constraint of constraints.advanced) {
    await track.applyConstraints({ ...track.getConstraints(), advanced: [...held, constraint] }).then(() => held.push(constraint), () => null);
  }
  return held.map((constraint) => Object.keys(constraint)[0]);
}

/** Let the camera choose its exposure, focus and white balance again. */
export const release = (track) => track.applyConstraints({ ...track.getConstraints(), advanced: [] }).catch(() => null);

/** Size and rate as a phone has them that is held upright, or lies on its long side. */
export function turned({ width, height, frame_rate_hz: rateHz }, isUpright) {
  const [long, short] = [Math.max(width, height), Math.min(width, height)];
  return isUpright ? { width: short, height: long, frame_rate_hz: rateHz } : { width: long, height: short, frame_rate_hz: rateHz };
}

/** Bring the camera to a size and rate, unless it has them; it is not turned. */
export async function adjust(track, settings) {
  const now = track.getSettings();
  const wanted = turned(settings, now.height > now.width);
  const isThere = now.width === wanted.width && now.height === wanted.height && Math.abs((now.frameRate ?? wanted.frame_rate_hz) - wanted.frame_rate_hz) < 0.5;
  if (!isThere) await track.applyConstraints(videoConstraints(wanted, now.facingMode)).catch(() => null);
}

/**
 * Facts and abilities of the track as the service takes them; none of a camera that does not tell its size.
 *
 * Browsers that don't tell a rate record about 30 frames a second.
 */
export function trackFacts(track) {
  const { width, height, frameRate: toldRate, facingMode } = track.getSettings();
  if (!(width > 0 && height > 0)) return {};
  const frameRate = toldRate > 0 ? toldRate : USUAL_RATE_HZ;
  const can = track.getCapabilities?.() ?? {};
  const label = cleanName(track.label ?? "", 100);
  return {
    track: { width, height, frame_rate_hz: frameRate, ...(facingMode && { facing: facingMode }), ...(label && { label }) },
    capabilities: {
      max_width: can.width?.max ?? width, max_height: can.height?.max ?? height, max_frame_rate_hz: can.frameRate?.max || frameRate,
      locks: HELD.map(([mode]) => mode).filter((mode) => STILL.some((name) => can[mode]?.includes(name))),
    },
  };
}

/** Frames that the browser itself had to leave out since the track began; null where it does not say. */
export const discardedFrames = (track) => track.stats?.discardedFrames ?? null;

/** Sentence of a camera that can't be opened. */
export function cameraProblem({ name }) {
  const causes = { NotAllowedError: PHONE.cameraRefused, NotFoundError: PHONE.cameraMissing };
  const [message, hint] = globalThis.isSecureContext ? causes[name] ?? PHONE.cameraBusy : PHONE.cameraInsecure;
  return { message, hint };
}

// Times at which the camera took its frames, by the callbacks of the picture that the phone shows.

// Standard deviations of a frame's time, by what the browser tells.
const KNOWN_STD_S = 0.004; // the time at which the camera took it
const SHOWN_STD_S = 0.02; // the time at which it was shown
const MAX_LATE_FRAMES = 0.6;

/** Time in seconds at which a frame was taken, with its standard deviation, from the facts of its callback. */
export function frameTime({ captureTime, presentationTime }) {
  return captureTime === undefined ? { timeS: presentationTime / 1000, stdS: SHOWN_STD_S } : { timeS: captureTime / 1000, stdS: KNOWN_STD_S };
}

/** Rate and lateness of the frames of a `<video>`, and functions to be called at one of the next frames. */
export class PreviewFrames {
  #video;
  #waiting = [];
  #intervals = [];
  #lastS = null;
  #lateS = 0;
  #handle = 0;
  #presented = null;
  numFrames = 0; // that were shown
  numMissing = 0; // that the camera took and the page did not see, by the times of the others

  constructor(video) {
    this.#video = video;
    if (this.isOffered) this.#next();
  }

  get isOffered() {
    return "requestVideoFrameCallback" in this.#video;
  }

  /** Median time between two frames; null while unknown. */
  get intervalS() {
    const sorted = [...this.#intervals].sort((one, other) => one - other);
    return sorted.length < 5 ? null : sorted[sorted.length >> 1];
  }

  /** True if frames come later to the page than the next ones are taken: nothing else should be done then. */
  get isLate() {
    return this.intervalS !== null && this.#lateS > MAX_LATE_FRAMES * this.intervalS;
  }

  /**
   * Promise of the next frame whose facts satisfy `wanted`, as `{ timeS, stdS, lateS }`; null after `timeoutS`, as the browser
   * tells of no frames while the page is hidden.
   */
  frame(wanted, timeoutS) {
    return new Promise((resolve) => {
      const entry = { wanted, resolve: (frame) => { clearTimeout(timer); resolve(frame); } };
      const timer = setTimeout(() => {
        this.#waiting = this.#waiting.filter((other) => other !== entry);
        resolve(null);
      }, 1000 * timeoutS);
      this.#waiting.push(entry);
    });
  }

  close() {
    if (this.isOffered) this.#video.cancelVideoFrameCallback(this.#handle);
    for (const { resolve } of this.#waiting.splice(0)) resolve(null);
  }

  #next() {
    this.#handle = this.#video.requestVideoFrameCallback((now, facts) => {
      this.#next();
      const numShown = this.#presented === null ? 1 : Math.max(1, facts.presentedFrames - this.#presented);
      this.#presented = facts.presentedFrames;
      this.#take({ ...frameTime(facts), arrivedS: facts.presentationTime / 1000, lateS: (performance.now() - facts.presentationTime) / 1000 }, numShown);
    });
  }

  // The browser may show several frames between two callbacks.
  #take(frame, numShown) {
    this.numFrames += numShown;
    this.#lateS = frame.lateS;
    const passedS = this.#lastS === null ? 0 : frame.timeS - this.#lastS;
    if (this.intervalS !== null) this.numMissing += Math.max(0, Math.round(passedS / this.intervalS) - numShown);
    if (passedS > 0) this.#intervals = [...this.#intervals, passedS / numShown].slice(-60);
    this.#lastS = frame.timeS;
    const ready = this.#waiting.filter(({ wanted }) => wanted(frame));
    this.#waiting = this.#waiting.filter((entry) => !ready.includes(entry));
    // At once, not in a later task: a recorder that is started here gets the next frame as its first.
    for (const { resolve } of ready) resolve(frame);
  }
}

// Small pictures of the phone's camera for the host, which never hold up the recording.

const EVERY_MS = 700;
const LONG_SIDE_PX = 240;
const QUALITY = 0.55;
const MAX_BYTES = 30_000;

export function smallSize(width, height) {
  const scale = LONG_SIDE_PX / Math.max(width, height);
  return [Math.max(1, Math.round(scale * width)), Math.max(1, Math.round(scale * height))];
}

/** Sends pictures of a `<video>` until it is stopped. `send(blob)` may refuse one; it is then left out. */
export class Thumbnails {
  #timer = 0;
  #canvas = document.createElement("canvas");
  numSkipped = 0;

  constructor(video, frames, send) {
    Object.assign(this, { video, frames, send });
    this.#timer = setInterval(() => this.#take(), EVERY_MS);
  }

  stop() {
    clearInterval(this.#timer);
  }

  #take() {
    const { videoWidth: width, videoHeight: height } = this.video;
    if (width === 0 || document.hidden) return;
    if (this.frames.isLate) {
      this.numSkipped += 1;
      return;
    }
    drawn(this.#canvas, this.video, smallSize(width, height));
    this.#canvas.toBlob((blob) => { if (blob && blob.size <= MAX_BYTES) this.send(blob); }, "image/jpeg", QUALITY);
  }
}

function drawn(canvas, video, [width, height]) {
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  canvas.getContext("2d").drawImage(video, 0, 0, width, height);
}

// Pictures for live captures, with the times at which the camera took them.

const [LIVE_SIDE_PX, MAX_SIDE_PX] = [640, 1024]; // usual, and what the service takes
const [LIVE_QUALITY, NO_FRAME_S, EARLY_S] = [0.8, 1, 0.01]; // frames come a little before or behind their time

/** Size of a live picture, in the exact proportions of the video where they allow it: to others a calibration can't be scaled. */
export function liveSize(width, height) {
  const divisor = (one, other) => (other ? divisor(other, one % other) : one);
  const common = divisor(width, height);
  const [across, down] = [width / common, height / common];
  const times = Math.min(common, Math.max(1, Math.floor(LIVE_SIDE_PX / Math.max(across, down))));
  if (times * Math.max(across, down) <= MAX_SIDE_PX) return [times * across, times * down];
  return [width, height].map((side) => Math.round((LIVE_SIDE_PX * side) / Math.max(width, height)));
}

/** Packet of a picture, a JPEG, with its time by the service's clock. */
export function livePacket(timeS, jpeg) {
  const time = new DataView(new ArrayBuffer(8));
  time.setFloat64(0, timeS, true);
  return new Blob(["MCP1", time, jpeg]);
}

/**
 * Sends pictures of a `<video>` until it is stopped, at a rate that the phone can hold: the next one is taken when the last one was
 * compressed. `send(packet)` may refuse one; it is then left out. While `isBusy()`, as a take is recorded, late frames are left alone.
 */
export class LivePictures {
  #canvas = document.createElement("canvas");
  #isStopped = false;

  constructor(video, frames, { rateHz, maxBytes, clock, isBusy, send }) {
    Object.assign(this, { video, frames, rateHz, maxBytes, clock, isBusy, send });
    this.#run();
  }

  stop() { this.#isStopped = true; }

  async #run() {
    let nextS = -Infinity;
    while (!this.#isStopped) {
      const frame = await this.frames.frame(({ timeS }) => timeS >= nextS, NO_FRAME_S);
      if (frame === null || this.#isStopped || !this.clock.isKnown || (this.isBusy() && this.frames.isLate)) continue;
      nextS = frame.timeS + 1 / this.rateHz - EARLY_S;
      drawn(this.#canvas, this.video, liveSize(this.video.videoWidth, this.video.videoHeight));
      const jpeg = await new Promise((resolve) => { this.#canvas.toBlob(resolve, "image/jpeg", LIVE_QUALITY); });
      const packet = livePacket(this.clock.serverS(frame.timeS), jpeg ?? "");
      if (jpeg && packet.size <= this.maxBytes && !this.#isStopped) this.send(packet);
    }
  }
}
