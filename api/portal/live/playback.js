// Playback of a recording into a live capture at its own pace, as if its cameras sent it now.

// Frames are read so much ahead of their time, and sent so often.
const AHEAD_S = 2;
const TICK_MS = 4;
const MAX_READ_AT_ONCE = 64;
// The first frame is due so much after the start, when the frames behind it are read.
const START_MS = 300;
const SHOWN_LATENCIES = 240;

/** Events: `end` when all frames are sent, `problem` (its `detail`) when a frame can't be read. */
export class Playback extends EventTarget {
  #client;
  #recording;
  #places; // of cameras in the message `ready`
  #queue = []; // frames that are read, with their people
  #numRead = 0;
  #isReading = false;
  #startMs = 0;
  #timer = 0;
  #sentMs = []; // time of each frame that was sent, as [timeS, milliseconds], of the last seconds
  #latencies = [];

  /** `client` is a `LiveClient` that is ready, `recording` comes from `openRecording`, `cameras` the names of `ready`. */
  constructor(client, recording, cameras) {
    super();
    this.#client = client;
    this.#recording = recording;
    this.#places = new Map(cameras.map((name, place) => [name, place]));
  }

  get lengthS() {
    const { frames } = this.#recording;
    return frames.at(-1).timeS - frames[0].timeS;
  }

  /** Time of the recording at the play head, from its first frame. */
  get timeS() {
    return Math.min(this.lengthS, Math.max(0, (performance.now() - this.#startMs) / 1000));
  }

  start() {
    this.#startMs = performance.now() + START_MS;
    this.#timer = setInterval(() => this.#tick(), TICK_MS);
  }

  stop() {
    clearInterval(this.#timer);
  }

  /** Note that an instant has come. */
  arrived({ timeS }) {
    // People of an instant are known by the last frame that shows it.
    while (this.#sentMs.length && this.#sentMs[0][0] < timeS - 1e-6) this.#sentMs.shift();
    const [frame] = this.#sentMs;
    if (!frame) return;
    this.#latencies.push(performance.now() - frame[1]);
    if (this.#latencies.length > SHOWN_LATENCIES) this.#latencies.shift();
  }

  /** Median and 95th percentile of the latest times from a frame to the people of its instant, in milliseconds; null: none. */
  get latencyMs() {
    if (this.#latencies.length === 0) return null;
    const sorted = [...this.#latencies].sort((one, other) => one - other);
    return [0.5, 0.95].map((share) => sorted[Math.min(sorted.length - 1, Math.floor(share * sorted.length))]);
  }

  #tick() {
    const { frames } = this.#recording;
    const nowS = frames[0].timeS + (performance.now() - this.#startMs) / 1000;
    while (this.#queue.length && this.#queue[0].timeS <= nowS) this.#send(this.#queue.shift());
    if (this.#numRead === frames.length && this.#queue.length === 0) {
      this.stop();
      this.dispatchEvent(new Event("end"));
    } else if (!this.#isReading) this.#read(nowS + AHEAD_S);
  }

  #send({ camera, timeS, people }) {
    const isSent = this.#client.send({ camera: this.#places.get(camera), timeS, people, numPoints: this.#recording.numPoints });
    const last = this.#sentMs.at(-1);
    if (isSent && last?.[0] === timeS) last[1] = performance.now();
    else if (isSent) this.#sentMs.push([timeS, performance.now()]);
  }

  async #read(untilS) {
    const { frames } = this.#recording;
    const first = this.#numRead;
    let stop = first;
    while (stop < frames.length && stop - first < MAX_READ_AT_ONCE && frames[stop].timeS <= untilS) stop += 1;
    if (stop === first) return;
    this.#isReading = true;
    try {
      const people = await Promise.all(frames.slice(first, stop).map(({ read }) => read()));
      this.#queue.push(...people.map((each, place) => ({ ...frames[first + place], people: each })));
      this.#numRead = stop;
    } catch (problem) {
      this.stop();
      this.dispatchEvent(new CustomEvent("problem", { detail: problem }));
    } finally {
      this.#isReading = false;
    }
  }
}
