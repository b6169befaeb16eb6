// Play head: a time on the session's clock, in steps of output frames. Views and videos follow it.

export const SPEEDS = [0.1, 0.25, 0.5, 1, 2];

// A tab that was in the background must not jump ahead by minutes.
const MAX_ELAPSED_S = 1;

/** Events: `time` when the play head has moved, `change` when playing, speed, loop or the range has changed. */
export class Player extends EventTarget {
  #timeS;
  #marks = { fromS: -Infinity, toS: Infinity }; // of the range that is played

  /** Frames `0` to `numFrames - 1` are at `startS + frame / rateHz`; frame 0 has the number `firstSourceFrame` in the source. */
  constructor(range) {
    super();
    this.#setRange(range);
    // True if time has to stand still for a moment; viewers set it.
    this.mustWait = () => false;
    this.isPlaying = false;
    this.isLooping = true;
    this.speed = 1;
    this.#timeS = this.startS;
  }

  /** Play other frames from now on; the play head stays at its time as far as it is among them. */
  setRange(range) {
    this.#setRange(range);
    this.seekTime(this.#timeS);
  }

  #setRange({ startS, rateHz, numFrames, firstSourceFrame = 0 }) {
    Object.assign(this, { startS, rateHz, numFrames, firstSourceFrame });
  }

  /** Exact time, which runs on between frames. */
  get timeS() {
    return this.#timeS;
  }

  get endS() {
    return this.startS + (this.numFrames - 1) / this.rateHz;
  }

  get frame() {
    return this.frameAt(this.#timeS);
  }

  /** Time of the frame that is shown. */
  get frameTimeS() {
    return this.startS + this.frame / this.rateHz;
  }

  frameAt(timeS) {
    return Math.min(this.numFrames - 1, Math.max(0, Math.round((timeS - this.startS) * this.rateHz)));
  }

  seek(frame) {
    this.seekTime(this.startS + Math.min(this.numFrames - 1, Math.max(0, frame)) / this.rateHz);
  }

  seekTime(timeS) {
    this.#timeS = Math.min(this.endS, Math.max(this.startS, timeS));
    this.dispatchEvent(new Event("time"));
  }

  /** Frames that are played, from the first to the last one. */
  get span() {
    const { fromS, toS } = this.#marks;
    return { from: this.frameAt(Math.max(fromS, this.startS)), to: this.frameAt(Math.min(toS, this.endS)) };
  }

  get hasSpan() {
    const { from, to } = this.span;
    return from > 0 || to < this.numFrames - 1;
  }

  /** Play the frames of a range alone; without a range, all frames. A mark behind the other one moves it away. */
  setSpan({ from = null, to = null } = {}) {
    const at = (frame) => this.startS + frame / this.rateHz;
    const { span } = this;
    const first = from ?? (to === null || span.from > to ? 0 : span.from);
    const last = to ?? (from === null || span.to < from ? this.numFrames - 1 : span.to);
    this.#marks = { fromS: first > 0 ? at(first) : -Infinity, toS: last < this.numFrames - 1 ? at(last) : Infinity };
    this.#set({});
  }

  step(frames) {
    this.pause();
    this.seek(this.frame + frames);
  }

  play() {
    const { from, to } = this.span;
    if (this.frame >= to) this.seek(from);
    this.#set({ isPlaying: true });
  }

  pause() {
    if (this.isPlaying) this.#set({ isPlaying: false });
  }

  toggle() {
    if (this.isPlaying) this.pause();
    else this.play();
  }

  setSpeed(speed) {
    this.#set({ speed });
  }

  setLooping(isLooping) {
    this.#set({ isLooping });
  }

  /** Let time pass while playing. Returns whether the play head has jumped back to the start. */
  advance(elapsedS) {
    if (!this.isPlaying) return false;
    const [startS, endS] = [Math.max(this.#marks.fromS, this.startS), Math.min(this.#marks.toS, this.endS)];
    let timeS = this.#timeS + Math.min(elapsedS, MAX_ELAPSED_S) * this.speed;
    // The last frame of all is shown for its duration; within the take, the next frame follows after half of it.
    const isOver = timeS > endS + (endS < this.endS ? 0.5 : 1) / this.rateHz;
    if (isOver && !this.isLooping) {
      this.pause();
      timeS = endS;
    }
    const isBack = isOver && this.isLooping;
    this.#timeS = isBack ? startS : timeS;
    this.dispatchEvent(new Event("time"));
    return isBack;
  }

  #set(values) {
    Object.assign(this, values);
    this.dispatchEvent(new Event("change"));
  }
}

/** Frames of takes on the session's clock, from the first to the last: of their own rate, or of another one as in files. */
export function frameRange(descriptions, rateHz = Math.max(...descriptions.map((take) => take.frame_rate_hz))) {
  const startS = Math.min(...descriptions.map((take) => take.start_time_s));
  const { first_source_frame: firstSourceFrame } = descriptions.find((take) => take.start_time_s === startS);
  const endS = Math.max(...descriptions.map((take) => take.start_time_s + (take.num_frames - 1) / take.frame_rate_hz));
  return { startS, rateHz, numFrames: Math.floor((endS - startS) * rateHz + 1e-6) + 1, firstSourceFrame };
}
