// Files of one recording by their names, on the cases of the pipeline; names of files in folders; files beside others.

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import test from "node:test";

import { isLaboratory, isPassedOver, detectKind, uniqueNames } from "../../../../api/portal/send/files.js";
import { groupRecordings } from "../../../../api/portal/send/matching.js";

const cases = JSON.parse(readFileSync(`${process.env.FIXTURES}/parts_cases.json`, "utf8"));

for (const { about, names, recordings } of cases) {
  test(about, () => assert.deepEqual(groupRecordings(names), recordings));
}

test("files of one name have the names of their folders before", () => {
  const file = (path) => ({ name: path.split("/").at(-1), webkitRelativePath: path });
  const files = ["take/left/DCIM/GX010001.MP4", "take/right/DCIM/GX010001.MP4", "take/door.mp4"].map(file);
  assert.deepEqual([...uniqueNames(files).values()], ["left_DCIM_GX010001.MP4", "right_DCIM_GX010001.MP4", "door.mp4"]);
  assert.deepEqual([...uniqueNames([{ name: "a.mp4" }, { name: "a.mp4" }]).values()], ["a.mp4", "a.mp4"]);
  // A file that is chosen by itself may take the place of one of a folder.
  assert.deepEqual([...uniqueNames([file("take/a.mp4"), { name: "a.mp4" }]).values()], ["a.mp4", "a.mp4"]);
});

test("files that systems and cameras put beside others", () => {
  const passed = ["._a.mp4", "take/__MACOSX/._a.mp4", "GX010001.LRV", "GX010001.thm", "VID_1.insv", "Thumbs.db"];
  assert.deepEqual(passed.filter(isPassedOver), passed);
  assert.deepEqual(["a.mp4", "take/a_._b.mp4", "lrv.mp4", "__macosx.mp4"].filter(isPassedOver), []);
});

test("an array of the points of all cameras", async () => {
  const kinds = await Promise.all(["mediapipe_2dData_numCams_pixelXY.npy", "body_3d_xyz.npy"].map((name) => detectKind({ name, type: "" })));
  assert.deepEqual(kinds, ["array", "points"]);
});

test("a document is 3D points, own points or a calibration by its content", async () => {
  const contents = {
    '{"people":[{"pose_keypoints_3d":[0.1,2.5]}]}': "points", '[{"id":0,"keypoints3d":[[-1.2,0,1,1]]}]': "points", '{"joint_names":["nose"]}': "points",
    '{"people":[{"pose_keypoints_2d":[1],"pose_keypoints_3d":[]}]}': "calibration", '{"bones":[["a","b"]]}': "ownPoints", '{"cameras":[]}': "calibration",
  };
  for (const [content, kind] of Object.entries(contents)) assert.equal(await detectKind(new File([content], "a.json")), kind, content);
  assert.equal(await detectKind(new File(["# ours\nobjects:\n  box: {}\n"], "a.yaml")), "ownPoints");
});

// Directory of a zip with these names, as far as it is read.
function zipOf(...names) {
  const entries = names.map((name) => {
    const head = Buffer.alloc(46);
    head.write("PK\u0001\u0002", "latin1");
    head.writeUInt16LE(name.length, 28);
    return Buffer.concat([head, Buffer.from(name, "latin1")]);
  });
  return new File(entries, "left.zip");
}

test("what a zip is, by the names in it", async () => {
  const kinds = {
    keypoints: [["left/000001.json"], ["leftDLC.csv"], ["labels/left_12.txt"], ["left.npy"]],
    calibration: [["cameras.txt", "images.txt", "points3D.txt"], ["intri.yml", "extri.yml"]],
    video: [["000001.json", "000001.jpg"]],
  };
  for (const [kind, zips] of Object.entries(kinds)) {
    for (const names of zips) assert.equal(await detectKind(zipOf(...names)), kind, names.join());
  }
});

test("a C3D file beside videos or keypoints is a laboratory's, else 3D points", () => {
  const row = (kind, name, isUsed = true) => ({ kind, name, isUsed });
  const trial = row("points", "Trial.C3D");
  const beside = (...others) => isLaboratory(trial, [trial, ...others]);
  assert.deepEqual([beside(row("video", "a.mp4")), beside(row("keypoints", "a.zip")), beside(row("array", "2d.npy"))], [true, true, true]);
  assert.deepEqual([beside(), beside(row("points", "b.c3d")), beside(row("video", "a.mp4", false))], [false, false, false]);
  assert.equal(isLaboratory(row("points", "a.trc"), [row("video", "a.mp4")]), false);
});
