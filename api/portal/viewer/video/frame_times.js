// Times of a camera's frames, interpolated between the rows of its clock: frame number, session's time, video's time.

const [FRAME, SESSION, VIDEO] = [0, 1, 2];

export class FrameClock {
  #rows;

  constructor(rows) {
    this.#rows = rows;
  }

  get hasVideo() {
    return this.#rows.length > 0 && this.#rows[0].length > VIDEO;
  }

  /** Number of the frame that is nearest to a time on the session's clock; null before the first and after the last. */
  frameAt(timeS) {
    const rows = this.#rows;
    if (rows.length === 0) return null;
    const halfS = this.intervalS / 2;
    if (timeS < rows[0][SESSION] - halfS || timeS > rows.at(-1)[SESSION] + halfS) return null;
    return Math.round(this.#map(timeS, SESSION, FRAME));
  }

  /** Frame that a video shows at its time. */
  frameAtVideo(videoS) {
    return Math.round(this.#map(videoS, VIDEO, FRAME));
  }

  frameTime(frame) {
    return this.#map(frame, FRAME, SESSION);
  }

  frameVideoTime(frame) {
    return this.#map(frame, FRAME, VIDEO);
  }

  /** Time in the video for a time on the session's clock, not rounded to a frame. */
  videoTimeAt(timeS) {
    return this.#map(timeS, SESSION, VIDEO);
  }

  get lastFrame() {
    return this.#rows.at(-1)[FRAME];
  }

  /** Mean interval of the frames. */
  get intervalS() {
    const [first, last] = [this.#rows[0], this.#rows.at(-1)];
    return (last[SESSION] - first[SESSION]) / Math.max(1, last[FRAME] - first[FRAME]);
  }

  /** Interpolate from one column to another; the ends hold beyond the rows. */
  #map(value, from, to) {
    const rows = this.#rows;
    if (value <= rows[0][from]) return rows[0][to];
    if (value >= rows.at(-1)[from]) return rows.at(-1)[to];
    let low = 0;
    let high = rows.length - 1;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (rows[middle][from] <= value) low = middle;
      else high = middle;
    }
    const share = (value - rows[low][from]) / (rows[high][from] - rows[low][from]);
    return rows[low][to] + share * (rows[high][to] - rows[low][to]);
  }
}
