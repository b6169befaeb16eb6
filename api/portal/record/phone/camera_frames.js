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
  numMissing = 0; // that the camera took and nobody saw, by the times of the others

  constructor(video) {
    this.#video = video;
    if (this.isOffered) this.#next();
  }

  /** Whether the browser tells of frames. */
  get isOffered() {
    return "requestVideoFrameCallback" in this.#video;
  }

  /** Median time between two frames; null while unknown. */
  get intervalS() {
    const sorted = [...this.#intervals].sort((one, other) => one - other);
    return sorted.length < 5 ? null : sorted[sorted.length >> 1];
  }

  /** Whether frames come later to the page than the next ones are taken: nothing else should be done then. */
  get isLate() {
    return this.intervalS !== null && this.#lateS > MAX_LATE_FRAMES * this.intervalS;
  }

  /**
   * Promise of the next frame whose facts satisfy `wanted`, as `{ timeS, stdS, lateS }`; null after `timeoutS`, as the browser
   * tells of no frames while nobody sees the page.
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
