// Projection by every lens model agrees with the pipeline's.

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { cameraCenter } from "../../../../api/portal/viewer/motion/records.js";
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

const isInPicture = ([u, v]) => u > 0 && v > 0 && u < 1920 && v < 1080;

for (const { name, camera, points, pixels } of cases) {
  test(`rays of lens ${name}`, () => {
    const lens = prepareLens(camera);
    const center = cameraCenter(camera.cam_from_world);
    let numSeen = 0;
    points.forEach((point, number) => {
      const offset = point.map((value, axis) => value - center[axis]);
      const { rotation: [, , forward] } = camera.cam_from_world;
      const depth = offset.reduce((sum, value, axis) => sum + value * forward[axis], 0);
      const away = Math.sqrt(offset.reduce((sum, value) => sum + value ** 2, 0) - depth ** 2) / depth;
      // Beyond the reach of a model a pixel shows several points.
      if (pixels[number] === null || !isInPicture(pixels[number]) || away > lens.reach) return;
      numSeen += 1;
      const ray = lens.ray(...pixels[number]);
      ray.forEach((value, axis) => assert.ok(Math.abs(value - offset[axis] / depth) < 1e-6, `point ${number}: ${ray}`));
    });
    assert.ok(numSeen > 5, `${numSeen} points`);
  });
}
