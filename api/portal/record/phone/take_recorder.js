// Recorder of a take: starts and stops at times of the service, and keeps each piece at once.

import { discardedFrames, trackFacts } from "./camera.js";
import { partKey } from "./journal.js";

const PIECE_MS = 500; // MP4 comes in pieces of a keyframe's distance
// Files that all browsers play come first; any of them can be read wherever it was cut.
const MIME_TYPES = [
  ...["avc1.64002A", "avc1.42E02A", "avc1.42E01E"].flatMap((video) => ["mp4a.40.2", "opus"].map((sound) => `video/mp4;codecs=${video},${sound}`)),
  "video/mp4", "video/webm;codecs=h264,opus", "video/webm;codecs=vp8,opus", "video/webm",
];
const [BITS_PER_PIXEL, MIN_BITS_PER_S] = [0.15, 4_000_000];
const KEYFRAME_MS = 1000;
const BEGIN_S = 0.4; // from which on nothing but the frames is waited for
const UNSEEN_STD_S = 0.05; // of a first frame that the browser told nothing of
const MAX_LATE_SHARE = 0.6; // of the time between frames, beyond which it is not certain which one is the first

/** Kinds of files that this browser can record, the best first. */
export const recordableTypes = () => MIME_TYPES.filter((type) => MediaRecorder.isTypeSupported(type));

/** Ending of files of a kind. */
export const fileEnding = (mimeType) => (mimeType.startsWith("video/mp4") ? "mp4" : "webm");

/** Bits a second of a video of a size and rate. */
export const bitsPerS = ({ width, height, frameRate = 30 }) => Math.round(Math.max(MIN_BITS_PER_S, BITS_PER_PIXEL * width * height * frameRate));

/**
 * Time of the first recorded frame, in the page's seconds, with its standard deviation.
 *
 * A recorder that is started while a frame is told of gets the next one as its first. `before` is the frame that was told of,
 * `first` the next one, both null where the browser tells of none; `startedS` is the time of the start.
 */
export function estimateFirstFrame({ before, first, startedS, intervalS }) {
  if (first === null) return { timeS: startedS + (intervalS ?? 0) / 2, stdS: UNSEEN_STD_S };
  const isCertain = before !== null && intervalS !== null && before.lateS < MAX_LATE_SHARE * intervalS;
  return { timeS: first.timeS, stdS: isCertain ? first.stdS : Math.hypot(first.stdS, (intervalS ?? UNSEEN_STD_S) / 2) };
}

const nowS = () => performance.now() / 1000;
const until = (localS) => new Promise((resolve) => { setTimeout(resolve, Math.max(0, 1000 * (localS - nowS()))); });

export class TakeRecorder {
  #parts; // stream, track, frames, clock, journal
  #recorder = null;
  #written = Promise.resolve(); // the pieces so far
  #from = null; // numbers of frames when it began
  #ended;
  #endS = null;
  numPieces = 0;
  numBytes = 0;
  problem = null;
  isCanceled = false;

  constructor({ stream, frames, clock, journal }, { recording, take, part }) {
    const [track] = stream.getVideoTracks();
    this.#parts = { stream, track, frames, clock, journal };
    Object.assign(this, { take, part, key: partKey(recording, take, part) });
    this.about = { recording, take, part };
  }

  /** Begin at a time of the service, or now if it is over. Returns facts of the first frame; null if it was canceled before. */
  async start(atServerS) {
    const { stream, track, frames, clock, journal } = this.#parts;
    const [mimeType] = recordableTypes();
    const atS = clock.localS(atServerS);
    await journal.begin(this.key, { ...this.about, mime_type: mimeType, track: trackFacts(track).track ?? null, at_s: Math.max(atServerS, clock.serverS(nowS())) });
    await until(atS - BEGIN_S);
    if (this.isCanceled) return null;
    const { intervalS } = frames;
    // The frame before the one that is to be the first.
    const before = await frames.frame(({ arrivedS }) => arrivedS >= atS - (intervalS ?? 0), Math.max(0, atS - nowS()) + BEGIN_S);
    if (this.isCanceled) return null;
    this.#recorder = new MediaRecorder(stream, { mimeType, videoBitsPerSecond: bitsPerS(track.getSettings()), videoKeyFrameIntervalDuration: KEYFRAME_MS });
    this.#ended = new Promise((resolve) => { this.#recorder.addEventListener("stop", () => { this.#endS = clock.serverS(nowS()); resolve(); }); });
    this.#recorder.addEventListener("dataavailable", ({ data }) => this.#keep(data));
    this.#recorder.addEventListener("error", ({ error }) => { this.problem = error; });
    this.#recorder.start(PIECE_MS);
    const startedS = nowS();
    this.#from = this.#counts();
    const first = estimateFirstFrame({ before, first: await frames.frame(({ arrivedS }) => arrivedS > startedS, BEGIN_S), startedS, intervalS });
    const facts = { at_s: clock.serverS(first.timeS), std_s: Math.hypot(first.stdS, clock.report(first.timeS).std_s) };
    this.#written = this.#written.then(() => journal.note(this.key, "first", facts));
    return { first_frame_s: facts.at_s, std_s: facts.std_s, mime_type: mimeType };
  }

  /** Promise of the end, by `stop` or because the camera is gone; resolves once all is kept. */
  async whenEnded() {
    await this.#ended;
    await this.#written.catch((problem) => { this.problem ??= problem; });
    await this.#parts.journal.end(this.key, { until_s: this.#endS, ...this.counts() });
  }

  async stop(atServerS) {
    await until(this.#parts.clock.localS(atServerS));
    this.isCanceled = true;
    if (this.#recorder && this.#recorder.state !== "inactive") this.#recorder.stop();
  }

  /** Numbers of frames that were recorded, and that were lost on the way. */
  counts() {
    if (this.#from === null) return { num_frames: 0, dropped: 0 };
    const now = this.#counts();
    return { num_frames: now.numFrames - this.#from.numFrames, dropped: now.dropped - this.#from.dropped };
  }

  #counts() {
    const { track, frames } = this.#parts;
    return { numFrames: track.stats?.deliveredFrames ?? frames.numFrames, dropped: discardedFrames(track) ?? frames.numMissing };
  }

  #keep(blob) {
    if (blob.size === 0) return;
    this.numPieces += 1;
    this.numBytes += blob.size;
    const fact = { until_s: this.#parts.clock.serverS(nowS()), ...this.counts() };
    this.#written = this.#written.then(() => this.#parts.journal.append(this.key, blob, fact)).catch((problem) => {
      this.problem ??= problem;
      if (this.#recorder.state !== "inactive") this.#recorder.stop();
    });
  }
}
