// Clock of the service, measured by messages that go there and back.

const MAX_SAMPLES = 240;
const BEST_SHARE = 0.25; // of the samples: the ones with the shortest round trips
const MIN_BEST = 4;
const MIN_DRIFT_SPAN_S = 60; // over less time the noise of round trips looks like drift
const MAX_STEP_S = 0.5; // a clock that was set, in place of one that drifts

const median = (values) => {
  const sorted = [...values].sort((one, other) => one - other);
  const half = sorted.length >> 1;
  return sorted.length % 2 ? sorted[half] : (sorted[half - 1] + sorted[half]) / 2;
};

/** Slope of a line through points `[x, y]`: the median of the slopes of all pairs (Theil and Sen). */
export function robustSlope(points) {
  const slopes = points.flatMap(([x, y], place) => points.slice(place + 1).filter(([other]) => other !== x).map(([other, value]) => (value - y) / (other - x)));
  return slopes.length ? median(slopes) : 0;
}

/**
 * Clock of the service by the page's own, `performance.now()` in seconds.
 *
 * A sample is the time at which a message was sent, the service's time when it answered, and the time at which the answer came.
 * The answer was made somewhere between the two: half a round trip is the largest error of a sample, so the shortest count.
 */
export class ServerClock {
  #samples = [];
  #line = null; // `{ atS, offsetS, drift, stdS }`

  get isKnown() {
    return this.#line !== null;
  }

  get numSamples() {
    return this.#samples.length;
  }

  /** Take the times of a message and its answer, in seconds. */
  add(sentS, serverS, receivedS) {
    const sample = { atS: (sentS + receivedS) / 2, offsetS: serverS - (sentS + receivedS) / 2, tripS: receivedS - sentS };
    if (this.#line && Math.abs(sample.offsetS - this.#offsetS(sample.atS)) > MAX_STEP_S + sample.tripS) this.#samples = [];
    this.#samples.push(sample);
    if (this.#samples.length > MAX_SAMPLES) this.#samples.shift();
    this.#line = this.#fit();
  }

  /** Service's time, in seconds since 1970, of a time of the page. */
  serverS(localS) {
    return localS + this.#offsetS(localS);
  }

  /** Time of the page of a time of the service. */
  localS(serverS) {
    const { atS, offsetS, drift } = this.#line;
    return (serverS - offsetS + drift * atS) / (1 + drift);
  }

  /** Offset, its standard deviation and the drift, as messages state them; null while nothing is known. */
  report(localS) {
    if (!this.#line) return null;
    return { offset_s: this.#offsetS(localS), std_s: this.#line.stdS, drift_ppm: 1e6 * this.#line.drift };
  }

  #offsetS(localS) {
    return this.#line.offsetS + this.#line.drift * (localS - this.#line.atS);
  }

  #fit() {
    const sorted = [...this.#samples].sort((one, other) => one.tripS - other.tripS);
    const best = sorted.slice(0, Math.max(MIN_BEST, Math.ceil(BEST_SHARE * sorted.length)));
    const times = best.map(({ atS }) => atS);
    const spanS = Math.max(...times) - Math.min(...times);
    const drift = spanS >= MIN_DRIFT_SPAN_S ? robustSlope(best.map(({ atS, offsetS }) => [atS, offsetS])) : 0;
    const atS = median(times);
    const offsetS = median(best.map((sample) => sample.offsetS - drift * (sample.atS - atS)));
    const rests = best.map((sample) => Math.abs(sample.offsetS - offsetS - drift * (sample.atS - atS)));
    // A way there that takes longer than the way back is in no sample: uniform within half the shortest trip.
    const unevenS = sorted[0].tripS / (2 * Math.sqrt(3));
    return { atS, offsetS, drift, stdS: Math.hypot(unevenS, (1.4826 * median(rests)) / Math.sqrt(best.length)) };
  }
}
