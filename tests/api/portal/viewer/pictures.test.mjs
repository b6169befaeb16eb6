// Pictures of videos in a smaller size, from the planes of a decoded frame.

import assert from "node:assert/strict";
import { test } from "node:test";
import { canShrink, shrink } from "../../../../api/portal/viewer/video/pictures.js";

/** Frame of four areas in the colours' Y, Cb and Cr, as a decoder gives it. */
function frameOf(format, colors, { width = 64, height = 32, padding = 6, colorSpace }) {
  const stride = width + padding;
  const half = format === "NV12" ? stride : stride / 2;
  const [luma, chroma] = [stride * height, half * (height / 2)];
  const data = new Uint8Array(luma + 2 * chroma);
  const colorAt = (x, y) => colors[(y < height / 2 ? 0 : 2) + (x < width / 2 ? 0 : 1)];
  for (let y = 0; y < height; y++) {
    for (let x = 0; x < width; x++) {
      const [bright, cb, cr] = colorAt(x, y);
      data[y * stride + x] = bright;
      const place = luma + (y >> 1) * half;
      if (format === "NV12") data.set([cb, cr], place + 2 * (x >> 1));
      else {
        data[place + (x >> 1)] = cb;
        data[place + chroma + (x >> 1)] = cr;
      }
    }
  }
  const layout = [{ offset: 0, stride }, { offset: luma, stride: half }];
  if (format === "I420") layout.push({ offset: luma + chroma, stride: half });
  return { format, data, layout, width, height, colorSpace };
}

// White, black, and a red and a blue of BT.709 in the limited range.
const COLORS = [[235, 128, 128], [16, 128, 128], [63, 102, 240], [32, 240, 118]];
const EXPECTED = [[255, 255, 255], [0, 0, 0], [255, 0, 0], [0, 0, 255]];

for (const format of ["I420", "NV12"]) {
  test(`${format} becomes colours in its places`, () => {
    assert.ok(canShrink(format));
    const [width, height] = [10, 6];
    const out = { width, height, data: new Uint8ClampedArray(4 * width * height) };
    shrink(frameOf(format, COLORS, { colorSpace: { matrix: "bt709", fullRange: false } }), out);
    for (const [number, [x, y]] of [[0, 0], [9, 0], [0, 5], [9, 5]].entries()) {
      const place = 4 * (y * width + x);
      const color = [...out.data.slice(place, place + 4)];
      [...EXPECTED[number], 255].forEach((value, channel) => assert.ok(Math.abs(color[channel] - value) <= 3, `${color} is not ${EXPECTED[number]}`));
    }
  });
}

test("detail smaller than a pixel becomes its mean", () => {
  const frame = frameOf("I420", [[100, 128, 128], [100, 128, 128], [100, 128, 128], [100, 128, 128]], { colorSpace: { matrix: "bt601", fullRange: true } });
  for (let place = 0; place < frame.layout[1].offset; place += 2) frame.data[place] = 200;
  const out = { width: 32, height: 16, data: new Uint8ClampedArray(4 * 32 * 16) };
  shrink(frame, out);
  assert.ok(out.data.every((value, place) => place % 4 === 3 || Math.abs(value - 150) <= 1));
});

test("other formats are left to the browser", () => assert.ok(!canShrink("RGBA") && !canShrink(null)));
