// Bodies that positions of joints bend, beside bodies that the rotations of the fit bend.

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { integers } from "../../../../api/portal/viewer/motion/records.js";
import { BodyPose, TRANSFORM_VALUES } from "../../../../api/portal/viewer/motion/orientations.js";

const cases = JSON.parse(readFileSync(`${process.env.FIXTURES}/bodies.json`));

/** Positions in a text of JSON, in metres. */
const metres = (text, body) => Float32Array.from(integers(text), (steps) => steps * body.step_m);

/** Vertices moved by the transforms of a body's joints. */
function skinned({ body, shape }, transforms) {
  const [vertices, carriers, weights] = [metres(shape.vertices, body), integers(body.carriers, Uint8Array), integers(body.weights, Uint8Array)];
  const skin = new Float32Array(vertices.length);
  for (let vertex = 0; vertex < vertices.length / 3; vertex++) {
    const [x, y, z] = vertices.subarray(3 * vertex);
    for (let place = 4 * vertex; place < 4 * vertex + 4; place++) {
      const matrix = transforms.subarray(TRANSFORM_VALUES * carriers[place]);
      for (let axis = 0; axis < 3; axis++) {
        skin[3 * vertex + axis] += (weights[place] / 255) * (matrix[axis] * x + matrix[4 + axis] * y + matrix[8 + axis] * z + matrix[12 + axis]);
      }
    }
  }
  return skin;
}

/** Distances between the vertices of two skins in millimetres, ascending. */
function distancesMm(skin, expected) {
  return expected.map((point, vertex) => 1000 * Math.hypot(...point.map((value, axis) => value - skin[3 * vertex + axis]))).sort((a, b) => a - b);
}

/** Transforms of a body's joints in a frame. */
function posed(motion, frame, change = () => {}) {
  const pose = new BodyPose(motion);
  const transforms = new Float32Array(pose.numJoints * TRANSFORM_VALUES);
  const [positions, marks] = [motion.positions[frame], motion.marks[frame]].map((points) => Float32Array.from(points.flat()));
  change(positions, marks);
  pose.write(metres(motion.shape.joints, motion.body), positions, marks, transforms, 0);
  return transforms;
}

for (const motion of cases) {
  test(`skins are where rotations have them: ${motion.name}`, () => {
    const all = motion.skins.map((expected, frame) => distancesMm(skinned(motion, posed(motion, frame)), expected));
    const share = (distances, part) => distances[Math.floor(part * (distances.length - 1))];
    const found = { half: Math.max(...all.map((d) => share(d, 0.5))), most: Math.max(...all.map((d) => share(d, 0.95))), worst: Math.max(...all.map((d) => d.at(-1))) };
    console.log(motion.name, found);
    assert.ok(found.half < 5 && found.most < 20 && found.worst < 60, JSON.stringify(found));
  });

  test(`the head faces where the face is: ${motion.name}`, () => {
    // Turned about its own height by a right angle, to the left.
    const turned = (positions, marks) => {
      const head = motion.skeleton.names.indexOf("Head");
      const [x, y] = [positions[3 * head], positions[3 * head + 1]];
      for (let place = 0; place < marks.length; place += 3) [marks[place], marks[place + 1]] = [x - (marks[place + 1] - y), y + (marks[place] - x)];
    };
    const head = TRANSFORM_VALUES * motion.body.joints.indexOf("Head");
    const [before, after] = [posed(motion, 0), posed(motion, 0, turned)];
    const front = (matrices) => [-matrices[head + 4], -matrices[head + 5]];
    const [[x, y], [alongX, alongY]] = [front(before), front(after)];
    assert.ok(Math.abs(Math.atan2(x * alongY - y * alongX, x * alongX + y * alongY) - Math.PI / 2) < 0.2);
    // Without a face it looks ahead.
    const blind = posed(motion, 0, (_, marks) => marks.fill(NaN));
    assert.ok(blind.every(Number.isFinite));
    const chest = TRANSFORM_VALUES * motion.body.joints.indexOf("Chest");
    assert.ok(blind[head + 4] * blind[chest + 4] + blind[head + 5] * blind[chest + 5] > 0.7);
  });
}
