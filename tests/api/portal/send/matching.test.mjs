// Cameras' names in the names of files, on the cases of the pipeline.

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import test from "node:test";

import { camerasInNames, inOrder, matchCameras, naturalOrder } from "../../../../api/portal/send/matching.js";

const cases = JSON.parse(readFileSync(`${process.env.FIXTURES}/pairing_cases.json`, "utf8"));

for (const { about, names, cameras, found } of cases) {
  test(about, () => {
    const files = names.map((name) => `${name}.mp4`);
    assert.deepEqual(files.map((file) => camerasInNames(files, cameras).get(file)), found);
  });
}

test("a file has its camera if no other file has it too", () => {
  const matched = matchCameras(["w_cam1.mp4", "r_cam1.mp4", "cam2.mov", "left right.mp4"], ["cam1", "cam2", "left", "right"]);
  assert.deepEqual(Object.fromEntries(matched), { "cam2.mov": "cam2" });
});

test("natural order", () => {
  const names = ["cam", "cam1", "Cam2", "cam02b", "cam10", "cam11", "left", "Left 2"];
  assert.deepEqual([...names].reverse().sort(naturalOrder), names);
});

test("eleven cameras in the order of their names", () => {
  const cameras = Array.from({ length: 11 }, (_, index) => `cam${index + 1}`).sort();
  const files = Array.from({ length: 11 }, (_, index) => `video${String(index + 1).padStart(2, "0")}.mp4`);
  const paired = inOrder(files, cameras);
  assert.deepEqual(files.map((file) => paired.get(file)), files.map((_, index) => `cam${index + 1}`));
});
