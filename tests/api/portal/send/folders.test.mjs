// Takes among the files of dropped folders.

import assert from "node:assert/strict";
import test from "node:test";

import { takesIn } from "../../../../api/portal/send/matching.js";

const KINDS = { mp4: "video", zip: "keypoints", json: "calibration", csv: "timestamps" };

function found(...paths) {
  const files = paths.map((path) => ({ name: path.split("/").at(-1), webkitRelativePath: path }));
  return takesIn(files, files.map(({ name }) => KINDS[name.split(".").at(-1)] ?? null));
}

const uniqueNames = (files) => files.map(({ webkitRelativePath: path }) => path);

test("a folder for each take, in natural order, with the calibration beside", () => {
  const { takes, beside } = found(
    "day/take 10/left.mp4", "day/take 10/right.mp4", "day/take 9/left.mp4", "day/take 9/right.mp4", "day/take 9/own.json", "day/rig.json", "day/notes.txt",
    "day/take 9/._left.mp4",
  );
  assert.deepEqual(takes.map(({ name }) => name), ["take 9", "take 10"]);
  assert.deepEqual(takes.map(({ hasCalibration }) => hasCalibration), [true, false]);
  assert.deepEqual(uniqueNames(takes[1].files), ["day/take 10/left.mp4", "day/take 10/right.mp4"]);
  assert.deepEqual(uniqueNames(beside), ["day/rig.json", "day/notes.txt"]);
});

test("folders that are dropped together, and a take with one camera, which its sending refuses", () => {
  const { takes } = found("walk/left.zip", "walk/right.zip", "run/left.mp4", "run/right.mp4", "jump/left.mp4");
  assert.deepEqual(takes.map(({ name }) => name), ["jump", "run", "walk"]);
});

test("the folders of cameras are no takes", () => {
  assert.equal(found("take/left/GX010001.mp4", "take/left/GX020001.mp4", "take/right/GX010001.mp4", "take/right/GX020001.mp4"), null);
  assert.equal(found("take/left.mp4", "take/right.mp4", "take/more/door.mp4"), null);
  assert.equal(found("left.mp4", "right.mp4"), null);
  assert.equal(found(), null);
});
