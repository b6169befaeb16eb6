// Pictures of videos at the size of the page, from the planes of a decoded frame: many times faster than drawing a large
// frame without a graphics card, since only pixels that are seen are converted.

const CHROMA = { I420: { step: 1, planes: [1, 2] }, NV12: { step: 2, planes: [1, 1] } };
// Samples of brightness a pixel, in each direction.
const MAX_SAMPLES = 3;
// Red from Cr, green from Cb and Cr, blue from Cb (ITU-R BT.709 and BT.601).
const MATRICES = { bt709: [1.5748, -0.1873, -0.4681, 1.8556], bt601: [1.402, -0.3441, -0.7141, 1.772] };

/** Whether frames of a format can be shrunk. */
export const canShrink = (format) => format in CHROMA;

/**
 * Write a frame in a smaller size.
 *
 * `frame` has `format` (I420 or NV12), `data` (bytes), `layout` (`offset` and `stride` of each plane), `width` and `height`
 * in pixels, and `colorSpace` as of a `VideoFrame`; `out` is an `ImageData`.
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
