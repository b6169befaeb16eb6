// Pictures of a camera's video that are kept at the size of the page. Without a graphics card, showing a large video costs
// more than all the rest: a take that loops, or that the user scrubs through, decodes no picture twice.

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

  /** True if the picture of a frame is kept, or is being made. */
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

// Pictures of videos at the size of the page, from the planes of a decoded frame: many times faster than drawing a large
// frame without a graphics card, since only pixels that are seen are converted.

const CHROMA = { I420: { step: 1, planes: [1, 2] }, NV12: { step: 2, planes: [1, 1] } };
// Samples of brightness a pixel, in each direction.
const MAX_SAMPLES = 3;
// Red from Cr, green from Cb and Cr, blue from Cb (ITU-R BT.709 and BT.601).
const MATRICES = { bt709: [1.5748, -0.1873, -0.4681, 1.8556], bt601: [1.402, -0.3441, -0.7141, 1.772] };

/** True if frames of a format can be shrunk. */
export const canShrink = (format) => format in CHROMA;

/**
 * Write a frame in a smaller size.
 *
 * `frame` has `format` (I420 or NV12), `data` (bytes), `layout` (`offset` and `stride` of each plane), `width` and `height`
 * in pixels, and `colorSpace` like a `VideoFrame`'s; `out` is an `ImageData`.
 */
export function shrink({ format, data, layout, width, height, colorSpace }, out) {
  const { step, planes: [blue, red] } = CHROMA[format];
  const [luma, cb, cr] = [layout[0], layout[blue], layout[red]];
  const crOffset = cr.offset + (format === "NV12" ? 1 : 0);
  const [rCr, gCb, gCr, bCb] = MATRICES[colorSpace?.matrix === "bt709" ? "bt709" : "bt601"];
  const [black, lumaGain, chromaGain] = colorSpace?.fullRange ? [0, 1, 1] : [16, 255 / 219, 255 / 224];
  const xs = samples(width, out.width);
  const ys = samples(height, out.height);
  const gain = lumaGain / (xs.count * ys.count);
  let place = 0;
  for (let y = 0; y < out.height; y++) {
    const chromaRow = ys.middle[y] >> 1;
    for (let x = 0; x < out.width; x++) {
      let sum = 0;
      for (let v = 0; v < ys.count; v++) {
        const row = luma.offset + ys.at[y * ys.count + v] * luma.stride;
        for (let u = 0; u < xs.count; u++) sum += data[row + xs.at[x * xs.count + u]];
      }
      const chroma = (xs.middle[x] >> 1) * step;
      const b = (data[cb.offset + chromaRow * cb.stride + chroma] - 128) * chromaGain;
      const r = (data[crOffset + chromaRow * cr.stride + chroma] - 128) * chromaGain;
      const bright = sum * gain - black * lumaGain;
      // An ImageData's bytes round and keep to their range by themselves.
      out.data[place] = bright + rCr * r;
      out.data[place + 1] = bright + gCb * b + gCr * r;
      out.data[place + 2] = bright + bCb * b;
      out.data[place + 3] = 255;
      place += 4;
    }
  }
  return out;
}

/** Pixels of a line of `from` pixels that make up each of `to` pixels. */
function samples(from, to) {
  const count = Math.min(MAX_SAMPLES, Math.max(1, Math.ceil(from / to)));
  const last = from - 1;
  const pixel = (place) => Math.min(last, Math.floor((place * from) / to));
  return {
    count,
    at: Int32Array.from({ length: to * count }, (_, number) => pixel((number + 0.5) / count)),
    middle: Int32Array.from({ length: to }, (_, number) => pixel(number + 0.5)),
  };
}
