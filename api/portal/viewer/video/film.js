// Decoder of a video that is fed by the page: picture after picture, without the seeking of a player, which decodes again from
// the last key for each picture.

import { readIndex } from "../../shared/mp4.js";
import { VIEWER } from "../../shared/strings/viewer.js";

const BLOCK_BYTES = 2 ** 20;
const MAX_BLOCKS = 8;
// Samples that a decoder is given ahead: it shows a picture when it knows those that follow.
const MAX_QUEUED = 6;

export class Film {
  #read;
  #index;
  #sampleByFrame; // sample of each frame
  #blocks = new Map(); // promises of bytes of the file, by the number of the block; the one used last is at the end
  #decoder = null;
  #next = null; // sample that is decoded next; null: the decoder has to begin with a key
  #from = 0; // frame of that key
  #shown = -1; // frame that came last since then
  #begunFor = null; // frame for which decoding began, until it has come
  #wake = () => {};
  #isOpen = true;

  /** Open a video; a promise of the film, or of null if the browser can't decode it so, or it has another number of frames. */
  static async open(url, numFrames) {
    if (!("VideoDecoder" in globalThis)) return null; // also in pages without TLS
    const read = async (start, stop) => {
      const answer = await fetch(url, { headers: { Range: `bytes=${start}-${stop - 1}` } });
      if (answer.status === 416) return new ArrayBuffer(0); // beyond the end
      if (answer.status !== 206) throw new Error(VIEWER.videoPartFailed(answer.status));
      return answer.arrayBuffer();
    };
    const index = await readIndex(read);
    if (index === null || index.sizes.length !== numFrames) return null;
    const { supported } = await VideoDecoder.isConfigSupported(decoderConfiguration(index));
    return supported ? new Film(read, index) : null;
  }

  constructor(read, index) {
    this.#read = read;
    this.#index = index;
    this.#sampleByFrame = new Uint32Array(index.frames.length);
    index.frames.forEach((frame, sample) => { this.#sampleByFrame[frame] = sample; });
    this.numDecoded = 0;
  }

  /**
   * Decode what is wanted until the film is closed.
   *
   * `goal()` is the frame that is wanted next; null: none, until `wake` is called. `take(frame, picture)` gets each picture
   * on the way, a `VideoFrame` that it closes, and may return a promise for which the next ones wait. Returns a promise that is
   * rejected if the video can't be decoded.
   */
  async run(goal, take) {
    let taking = Promise.resolve();
    let broken = null;
    const moved = () => this.#wake();
    const output = (picture) => {
      this.numDecoded += 1;
      if (picture.timestamp < this.#from) return picture.close(); // it refers to pictures before the key
      this.#shown = picture.timestamp;
      if (picture.timestamp === this.#begunFor) this.#begunFor = null;
      const taken = take(picture.timestamp, picture);
      taking = Promise.all([taking, taken]).then(moved);
      return undefined;
    };
    const error = (problem) => {
      broken = problem;
      moved();
    };
    while (this.#isOpen) {
      if (broken !== null) throw broken;
      const frame = goal();
      if (frame === null) await this.#woken();
      else if (this.#mustBegin(frame)) this.#begin(frame, { output, error });
      else if (this.#decoder.decodeQueueSize >= MAX_QUEUED) await this.#woken();
      else if (this.#next === this.#index.sizes.length) await this.#end();
      else await this.#feed();
      await taking;
    }
  }

  /** Ask again what is wanted. */
  wake() {
    this.#wake();
  }

  close() {
    this.#isOpen = false;
    if (this.#decoder !== null && this.#decoder.state !== "closed") this.#decoder.close();
    this.#wake();
  }

  #woken() {
    return new Promise((resolve) => { this.#wake = resolve; });
  }

  /** True if a frame comes sooner, or at all, if decoding restarts at the key before it. */
  #mustBegin(frame) {
    return this.#next === null || frame <= this.#shown || this.#keyBefore(frame) > this.#next;
  }

  /** Last sample with which decoding can begin for a frame. */
  #keyBefore(frame) {
    const { isKey, frames } = this.#index;
    let sample = this.#sampleByFrame[frame];
    while (sample > 0 && !(isKey[sample] && frames[sample] <= frame)) sample -= 1;
    return sample;
  }

  #begin(frame, callbacks) {
    // It came to nothing before: the decoder leaves this picture out.
    if (frame === this.#begunFor) throw new Error(VIEWER.frameFailed(frame));
    this.#begunFor = frame;
    if (this.#decoder === null) {
      this.#decoder = new VideoDecoder(callbacks);
      this.#decoder.addEventListener("dequeue", () => this.#wake());
    } else {
      this.#decoder.reset();
    }
    this.#decoder.configure(decoderConfiguration(this.#index));
    this.#next = this.#keyBefore(frame);
    this.#from = this.#index.frames[this.#next];
    this.#shown = this.#from - 1;
  }

  async #feed() {
    const sample = this.#next;
    const { frames, isKey } = this.#index;
    const data = await this.#readBytes(sample);
    if (!this.#isOpen) return;
    this.#decoder.decode(new EncodedVideoChunk({ type: isKey[sample] ? "key" : "delta", timestamp: frames[sample], data }));
    this.#next = sample + 1;
  }

  /** Get the last pictures out of the decoder. */
  async #end() {
    this.#next = null;
    await this.#decoder.flush().catch(() => {}); // closed meanwhile
  }

  async #readBytes(sample) {
    const start = this.#index.offsets[sample];
    const stop = start + this.#index.sizes[sample];
    const numbers = [];
    for (let block = Math.floor(start / BLOCK_BYTES); block * BLOCK_BYTES < stop; block++) numbers.push(block);
    const blocks = await Promise.all(numbers.map((number) => this.#block(number)));
    const bytes = new Uint8Array(stop - start);
    blocks.forEach((block, place) => {
      const from = numbers[place] * BLOCK_BYTES;
      const part = new Uint8Array(block).subarray(Math.max(0, start - from), Math.max(0, stop - from));
      bytes.set(part, Math.max(0, from - start));
    });
    return bytes;
  }

  #block(number) {
    const bytes = this.#blocks.get(number) ?? this.#read(number * BLOCK_BYTES, (number + 1) * BLOCK_BYTES);
    this.#blocks.delete(number);
    this.#blocks.set(number, bytes);
    if (this.#blocks.size > MAX_BLOCKS) this.#blocks.delete(this.#blocks.keys().next().value);
    return bytes;
  }
}

function decoderConfiguration({ codec, description }) {
  return { codec, description, hardwareAcceleration: "prefer-software", optimizeForLatency: true };
}
