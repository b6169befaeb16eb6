// Projection by every lens model agrees with the pipeline's.

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { prepareLens } from "../../../../api/portal/viewer/video/overlay.js";

const cases = JSON.parse(readFileSync(`${process.env.FIXTURES}/lenses.json`));

for (const { name, camera, points, pixels } of cases) {
  test(`lens ${name}`, () => {
    const lens = prepareLens(camera);
    const out = [0, 0];
    let numSeen = 0;
    points.forEach((point, number) => {
      lens.project(...point, out);
      const expected = pixels[number];
      if (expected === null) return assert.ok(Number.isNaN(out[0]) && Number.isNaN(out[1]), `point ${number} is not seen`);
      numSeen += 1;
      // Where a lens model folds over, pixels are huge and their rounding with them.
      const tolerance = 1e-6 * (1 + Math.hypot(...expected));
      return assert.ok(Math.hypot(out[0] - expected[0], out[1] - expected[1]) < tolerance, `point ${number}: ${out} is not ${expected}`);
    });
    assert.ok(numSeen > points.length / 10);
  });
}
