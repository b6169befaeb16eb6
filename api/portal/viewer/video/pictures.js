// Pictures of a camera's video that are kept at the size of the page. Without a graphics card, showing a large video costs
// more than all the rest: a take that loops, or that somebody scrubs through, decodes no picture twice.

import { canShrink, shrink } from "./shrink.js";

const KEPT_BYTES = 256 * 2 ** 20;

export class Pictures {
  #kept = new Map(); // by number of the frame, the one that was kept last at the end
  #taking = Promise.resolve();
  #size = [0, 0];
  #bytes = new Uint8Array(0);
  #sheet = null; // for browsers that give no planes of frames

  /** Pictures of one of `numVideos` videos, which share the memory. */
  constructor(video, numVideos) {
    this.video = video;
    this.budget = KEPT_BYTES / numVideos;
    this.maxCount = 0; // pictures that are kept at most
  }

  /** Picture of a frame; undefined if it is not kept. */
  get(frame) {
    return this.#kept.get(frame);
  }

  /** Kept frame that is nearest to a frame, at most `distance` frames away; null without one. */
  nearest(frame, distance) {
    for (let away = 0; away <= distance; away++) {
      for (const near of [frame - away, frame + away]) if (this.#kept.has(near)) return near;
    }
    return null;
  }

  /** First frame from `from` up to `to` without a kept picture at most `distance` frames away; null if there is none. */
  firstMissing(from, to, distance) {
    for (let frame = from; frame <= to; frame++) if (this.nearest(frame, distance) === null) return frame;
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

  /** Keep what the video shows, which is a frame; returns a promise of whether it is kept. */
  take(frame) {
    if (this.#kept.has(frame) || this.#size[0] * this.#size[1] === 0) return Promise.resolve(this.#kept.has(frame));
    const [source, size] = [this.#source(), this.#size];
    this.#taking = this.#taking.then(async () => {
      const picture = source === null ? null : await this.#shrunk(source, size);
      source?.close?.();
      if (picture === null || size !== this.#size) return false; // of the size before
      this.#keep(frame, picture);
      return true;
    });
    return this.#taking;
  }

  #source() {
    try {
      return new VideoFrame(this.video);
    } catch { // no picture yet, or a browser without WebCodecs
      return this.video.readyState >= HTMLMediaElement.HAVE_CURRENT_DATA && typeof VideoFrame === "undefined" ? this.video : null;
    }
  }

  async #shrunk(source, [width, height]) {
    // Pictures that are turned for display, or have other planes, are drawn.
    const isPlain = canShrink(source.format) && source.visibleRect.width === this.video.videoWidth && source.visibleRect.height === this.video.videoHeight && !source.rotation;
    if (!isPlain) return this.#drawn(source, width, height);
    const { format, colorSpace, visibleRect } = source;
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

  #keep(frame, picture) {
    this.#kept.set(frame, picture);
    if (this.#kept.size > this.maxCount) this.#kept.delete(this.#kept.keys().next().value);
  }
}
