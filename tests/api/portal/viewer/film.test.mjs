// Pictures of a video that the page decodes: index of the file, and the order of decoding.

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { Film } from "../../../../api/portal/viewer/video/film.js";
import { readIndex } from "../../../../api/portal/shared/mp4.js";
import { Pictures } from "../../../../api/portal/viewer/video/pictures.js";

const folder = process.env.FIXTURES;
const expected = JSON.parse(readFileSync(`${folder}/videos.json`, "utf8"));
const openFile = (name) => readFileSync(`${folder}/${name}`);

function reader(bytes, asked = []) {
  return async (start, stop) => {
    asked.push([start, stop]);
    const part = bytes.subarray(start, stop);
    return part.buffer.slice(part.byteOffset, part.byteOffset + part.length);
  };
}

for (const name of Object.keys(expected)) {
  test(`index of ${name}`, async () => {
    const bytes = openFile(name);
    const index = await readIndex(reader(bytes));
    const { codec, samples } = expected[name];
    assert.equal(index.codec, codec);
    assert.ok(index.description.length > 7 && index.description[0] === 1);
    assert.deepEqual(samples, samples.map((_, sample) => ({
      offset: index.offsets[sample], size: index.sizes[sample], is_key: index.isKey[sample] === 1, frame: index.frames[sample],
    })));
  });
}

test("an index is read without the pictures", async () => {
  const asked = [];
  const bytes = openFile("keys.mp4");
  await readIndex(reader(bytes, asked));
  const numRead = asked.reduce((sum, [start, stop]) => sum + Math.min(stop, bytes.length) - start, 0);
  assert.ok(numRead < bytes.length / 2, `${numRead} of ${bytes.length} bytes`);
});

for (const name of ["h264-fragmented.mp4", "h264-rotated-90.mp4", "hevc-8.mp4", "mpeg4-b-frames.mp4", "vp9.webm"]) {
  test(`${name} is left to the browser's player`, async () => {
    assert.equal(await readIndex(reader(openFile(name))), null);
  });
}

for (const [what, bytes] of [["nothing", Buffer.alloc(0)], ["no MP4", Buffer.from("RIFF....AVI LIST and more of it")], ["half a file", openFile("keys.mp4").subarray(0, 300)]]) {
  test(`${what} has no index`, async () => {
    assert.equal(await readIndex(reader(bytes)), null);
  });
}

// Decoder that shows a picture two samples late, in the order of showing, as real ones do.
class FakeDecoder extends EventTarget {
  static numMade = 0;
  state = "unconfigured";
  #waiting = [];
  #queue = [];

  constructor({ output, error }) {
    super();
    Object.assign(this, { output, error });
    FakeDecoder.numMade += 1;
  }

  static async isConfigSupported() { return { supported: true }; }
  get decodeQueueSize() { return this.#queue.length; }
  configure() { this.state = "configured"; }
  reset() { [this.#waiting, this.#queue, this.state] = [[], [], "unconfigured"]; }
  close() { this.reset(); this.state = "closed"; }

  decode(chunk) {
    assert.ok(this.#queue.length || this.#waiting.length || chunk.type === "key" || this.hasKey, "begins with a key");
    this.hasKey = true;
    this.#queue.push(chunk);
    setImmediate(() => {
      const next = this.#queue.shift();
      if (next === undefined) return;
      this.#waiting.push(next.timestamp);
      this.dispatchEvent(new Event("dequeue"));
      if (this.#waiting.length > 2) this.#show();
    });
  }

  async flush() {
    while (this.#queue.length) await new Promise(setImmediate);
    while (this.#waiting.length) this.#show();
    this.hasKey = false;
  }

  #show() {
    this.#waiting.sort((one, other) => one - other);
    this.output({ timestamp: this.#waiting.shift(), close() {} });
  }
}
globalThis.VideoDecoder = FakeDecoder;
globalThis.EncodedVideoChunk = class { constructor(init) { Object.assign(this, init); } };

async function filmOf(name) {
  const bytes = openFile(name);
  globalThis.fetch = async (_, { headers: { Range } }) => {
    const [, start, stop] = /bytes=(\d+)-(\d+)/.exec(Range).map(Number);
    const part = bytes.subarray(start, stop + 1);
    return { status: part.length ? 206 : 416, arrayBuffer: async () => part.buffer.slice(part.byteOffset, part.byteOffset + part.length) };
  };
  return Film.open("/video.mp4", expected[name].samples.length);
}

/** Run a film through goals, one after the other; returns the frames that came for each. */
async function shownFor(film, goals) {
  const came = goals.map(() => []);
  let place = 0;
  const ended = film.run(() => goals[place] ?? null, (frame) => {
    came[place].push(frame);
    if (frame === goals[place]) place += 1;
    if (place === goals.length) film.close();
  });
  await ended;
  return came;
}

test("a film shows frames on the way to the one that is wanted", async () => {
  const film = await filmOf("keys.mp4");
  const [first, second] = await shownFor(film, [10, 12]);
  assert.deepEqual(first, Array.from({ length: 11 }, (_, frame) => frame));
  assert.deepEqual(second, [11, 12]);
});

test("it begins at the key before a frame that is far, and goes back for one that has passed", async () => {
  const film = await filmOf("keys.mp4");
  const keys = expected["keys.mp4"].samples.filter((sample) => sample.is_key).map(({ frame }) => frame);
  const partKey = (frame) => keys.findLast((key) => key <= frame);
  assert.ok(partKey(40) > 10 && partKey(31) < 31, `${keys}`);
  const [, far, back, last] = await shownFor(film, [2, 40, 31, 59]);
  assert.deepEqual([far[0], far.at(-1)], [partKey(40), 40]);
  assert.deepEqual([back[0], back.at(-1)], [partKey(31), 31]);
  assert.ok(last[0] > 31 && last.at(-1) === 59, "the last frames come out of the decoder");
});

test("a video with another number of frames, or that can't be decoded, is left to the player", async () => {
  const film = await filmOf("keys.mp4");
  film.close();
  assert.equal(await Film.open("/video.mp4", 59), null);
});

test("a frame that never comes ends the film", async () => {
  const film = await filmOf("keys.mp4");
  const output = FakeDecoder.prototype.flush;
  FakeDecoder.prototype.flush = async function flush() { this.reset(); this.configure(); this.hasKey = false; };
  await assert.rejects(film.run(() => 59, () => null), /can't be decoded/);
  FakeDecoder.prototype.flush = output;
});

test("pictures that are missing", async () => {
  const pictures = new Pictures(4);
  pictures.resize(2, 2);
  globalThis.ImageData = class { constructor(width, height) { Object.assign(this, { width, height, data: new Uint8ClampedArray(4 * width * height) }); } };
  const frame = () => ({
    format: "I420", visibleRect: { width: 4, height: 4 }, allocationSize: () => 24, close() {},
    copyTo: async () => [{ offset: 0, stride: 4 }, { offset: 16, stride: 2 }, { offset: 20, stride: 2 }],
  });
  for (const number of [4, 6, 12]) await pictures.take(number, frame());
  assert.equal(pictures.firstMissing(3, 20, 1), 8);
  assert.equal(pictures.firstMissing(4, 7, 1), null);
  assert.equal(pictures.firstMissing(0, 20, 0), 0);
  assert.equal(pictures.firstMissing(12, 12, 0), null);
  assert.equal(pictures.nearest(5, 0), null);
  assert.equal(pictures.nearest(9, 3), 6);
  const taking = pictures.take(20, frame());
  assert.ok(pictures.has(20) && pictures.get(20) === undefined, "it is being made");
  await taking;
  assert.equal(pictures.get(20).width, 2);
  assert.ok(pictures.resize(4, 4) && !pictures.has(20));
});
