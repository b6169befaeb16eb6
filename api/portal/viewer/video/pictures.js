// Pictures of a camera's video that are kept at the size of the page. Without a graphics card, showing a large video costs
// more than all the rest: a take that loops, or that somebody scrubs through, decodes no picture twice.

import { canShrink, shrink } from "./shrink.js";

const KEPT_BYTES = 256 * 2 ** 20;

export class Pictures {
  #kept = new Map(); // by number of the frame, the one that was kept last at the end; null while it is made
  #size = [0, 0];
  #bytes = new Uint8Array(0);
  #making = Promise.resolve();
  #sheet = null; // for decoders that give no planes of frames

  /** Pictures of one of `numVideos` videos, which share the memory. */
  constructor(numVideos) {
    this.budget = KEPT_BYTES / numVideos;
    this.maxCount = 0; // pictures that are kept at most
  }

  /** Picture of a frame; undefined if it is not kept. */
  get(frame) {
    return this.#kept.get(frame) ?? undefined;
  }

  /** Whether the picture of a frame is kept, or is being made. */
  has(frame) {
    return this.#kept.has(frame);
  }

  /** Frame with a kept picture that is nearest to a frame, at most `distance` frames away; null without one. */
  nearest(frame, distance) {
    for (let away = 0; away <= distance; away++) {
      for (const near of [frame - away, frame + away]) if (this.get(near) !== undefined) return near;
    }
    return null;
  }

  /** First frame from `from` up to `to` of which no picture at most `distance` frames away is kept or made; null if there is none. */
  firstMissing(from, to, distance) {
    for (let frame = from; frame <= to;) {
      let near = frame + distance;
      while (near >= frame - distance && !this.has(near)) near -= 1;
      if (near < frame - distance) return frame;
      frame = near + distance + 1;
    }
    return null;
  }

  /** Keep pictures of another size from now on. Returns whether it is another one. */
  resize(width, height) {
    if (this.#size[0] === width && this.#size[1] === height) return false;
    this.#size = [width, height];
    this.#kept.clear();
    this.maxCount = Math.max(1, Math.floor(this.budget / (4 * width * height)));
    return true;
  }

  /** Keep the picture of a frame, a `VideoFrame`, which is closed; returns a promise of whether it is kept. */
  take(frame, source) {
    const size = this.#size;
    this.#kept.set(frame, null);
    if (this.#kept.size > this.maxCount) this.#kept.delete(this.#kept.keys().next().value);
    // One after the other: they share memory.
    this.#making = this.#making.then(async () => {
      const picture = size === this.#size ? await this.#made(source, size) : null;
      source.close();
      if (picture === null || size !== this.#size || !this.#kept.has(frame)) return false; // of the size before
      this.#kept.set(frame, picture);
      return true;
    });
    return this.#making;
  }

  async #made(source, [width, height]) {
    const { format, colorSpace, visibleRect } = source;
    if (!canShrink(format)) return this.#drawn(source, width, height);
    const numBytes = source.allocationSize();
    if (this.#bytes.length < numBytes) this.#bytes = new Uint8Array(numBytes);
    const layout = await source.copyTo(this.#bytes);
    return shrink({ format, data: this.#bytes, layout, width: visibleRect.width, height: visibleRect.height, colorSpace }, new ImageData(width, height));
  }

  #drawn(source, width, height) {
    this.#sheet ??= document.createElement("canvas").getContext("2d", { willReadFrequently: true });
    Object.assign(this.#sheet.canvas, { width, height });
    this.#sheet.drawImage(source, 0, 0, width, height);
    return this.#sheet.getImageData(0, 0, width, height);
  }
}
