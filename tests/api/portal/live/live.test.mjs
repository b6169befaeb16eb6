// Packets, recordings and people of the view Live.

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { packKeypoints, unpackInstant } from "../../../../api/portal/live/client.js";
import { listEntries, parsePeople, openRecording, sortedFiles, readText } from "../../../../api/portal/live/keypoints.js";
import { LiveStore } from "../../../../api/portal/live/scene.js";

const read = (name) => readFileSync(`${process.env.FIXTURES}/${name}`);
const expected = JSON.parse(read("expected.json"));
const bufferOf = (bytes) => bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length);
const zipOf = (name) => new File([read(name)], name);
const plain = (values) => [...values].map((value) => (Number.isNaN(value) ? null : value));
const times = (...rows) => new File([["camera,frame,time_s", ...rows].join("\n")], "timestamps.csv");
const EVERY_TIME = ["cam_1", "cam_2"].flatMap((camera, late) => [0, 2, 10].map((frame) => `${camera},${frame},${frame / 25 + late / 100}`));

test("an instant is read as the service packs it", () => {
  const instant = unpackInstant(bufferOf(read("instant.bin")));
  assert.deepEqual([instant.timeS, instant.lagS, instant.sequence, instant.dropped], [12.25, 0.5, 7, { input: 0, output: 0 }]);
  assert.deepEqual(instant.people.map(({ id }) => id), [1, 70000]);
  assert.equal(instant.people[0].skeleton, null);
  instant.people.forEach(({ joints }, person) => assert.deepEqual(plain(joints), expected.located[person]));
  const { skeleton } = instant.people[1];
  for (const [name, values] of Object.entries(expected.skeleton)) assert.deepEqual(plain(skeleton[name]), values, name);
  assert.throws(() => unpackInstant(bufferOf(read("instant.bin").subarray(0, -4))));
  assert.throws(() => unpackInstant(bufferOf(read("keypoints.bin"))));
});

test("keypoints are packed as the library packs them", () => {
  const packet = packKeypoints({ camera: 3, timeS: 1.5, people: [expected.row.map((value) => value ?? NaN)], numPoints: 17 });
  assert.deepEqual(Buffer.from(packet), read("keypoints.bin"));
});

test("zips of cameras are a recording", async () => {
  const sorted = await sortedFiles([zipOf("cam_1.zip"), zipOf("cam_2.zip"), new File(["{}"], "calibration.json"), times(...EVERY_TIME)]);
  assert.deepEqual(sorted.views.map(({ name, frames }) => [name, [...frames.keys()]]), [["cam_1", [0, 2, 10]], ["cam_2", [0, 2, 10]]]);
  assert.equal(sorted.calibration.name, "calibration.json");
  const recording = await openRecording(sorted, ["cam_1", "cam_2", "cam_3"], null);
  assert.deepEqual(recording.frames.map(({ camera, timeS }) => [camera, timeS]), [["cam_1", 0], ["cam_2", 0.01], ["cam_1", 0.08], ["cam_2", 2 / 25 + 1 / 100], ["cam_1", 0.4], ["cam_2", 10 / 25 + 1 / 100]]);
  assert.deepEqual([recording.layout, recording.numPoints], ["coco-17", 17]);
  assert.deepEqual([await recording.frames[0].read(), (await recording.frames[5].read())[0].length], [[], 51]);
});

test("what can't be played is named", async () => {
  const sorted = await sortedFiles([zipOf("cam_1.zip"), zipOf("cam_2.zip")]);
  await assert.rejects(openRecording(sorted, ["left", "right"], 25), /cam_1, cam_2/);
  await assert.rejects(openRecording({ ...sorted, timestamps: times("cam_1,0,0") }, ["cam_1", "cam_2"], null), /Frames of cam_1/);
  await assert.rejects(openRecording({ ...sorted, timestamps: times("cam_1,x,0") }, ["cam_1", "cam_2"], null), /Line 2/);
  await assert.rejects(listEntries(new File(["nothing"], "a.zip")), /not a zip/);
  assert.throws(() => parsePeople("[]"), /OpenPose/);
  assert.deepEqual(parsePeople('{"people": [null, {}, {"pose_keypoints_2d": "x"}, {"pose_keypoints_2d": [1, 2, 0.5]}]}'), [[1, 2, 0.5]]);
});

test("an entry of a zip that is larger than it states is not read", async () => {
  const [, entry] = await listEntries(zipOf("cam_1.zip"));
  assert.match(await readText(zipOf("cam_1.zip"), entry), /pose_keypoints_2d/);
  await assert.rejects(readText(zipOf("cam_1.zip"), { ...entry, numBytes: 20 }), /larger than it states/);
});

test("points of BODY_25B are told from those of BODY_25", async () => {
  const framesOf = (row) => ["cam_1", "cam_2"].flatMap((camera) => [1, 2, 3, 4, 5].map((frame) => {
    const text = JSON.stringify({ people: [{ pose_keypoints_2d: row.flatMap(([x, y]) => [x + 1, y + 1, 0.9]) }] });
    const file = new File([text], `a_${frame}_keypoints.json`);
    Object.defineProperty(file, "webkitRelativePath", { value: `all/${camera}/a_${frame}_keypoints.json` });
    return file;
  }));
  const findLayout = async (row) => (await openRecording(await sortedFiles(framesOf(row)), ["cam_1", "cam_2"], 25)).layout;
  const both = (x, y) => [[50 + x, y], [50 - x, y]]; // left, right
  const [[lShoulder, rShoulder], [lElbow, rElbow], [lWrist, rWrist], [lHip, rHip], [lKnee, rKnee], [lAnkle, rAnkle]] = [both(18, 30), both(22, 60), both(24, 90), both(10, 95), both(10, 140), both(10, 185)];
  const face = [...both(3, 8), ...both(6, 10)];
  const feet = [...both(12, 190), ...both(14, 190), ...both(9, 188)];
  const body25B = [[50, 10], ...face, lShoulder, rShoulder, lElbow, rElbow, lWrist, rWrist, lHip, rHip, lKnee, rKnee, lAnkle, rAnkle, [50, 26], [50, 0], ...feet];
  const body25 = [[50, 10], [50, 30], rShoulder, rElbow, rWrist, lShoulder, lElbow, lWrist, [50, 95], rHip, rKnee, rAnkle, lHip, lKnee, lAnkle, ...face, ...feet];
  assert.equal(await findLayout(body25B), "body-25b");
  assert.equal(await findLayout(body25), "body-25");
});

test("people without bones are shown by their joints, and trails end where people were not there", () => {
  const { bones, parents, joint_names: joints } = expected;
  const store = new LiveStore({ bones, parents, joints, rig: [] }, 25);
  const located = Float32Array.from(joints.flatMap((_, joint) => [joint, 0, 1]));
  const out = new Float32Array(3 * bones.length);
  assert.ok(store.add({ people: [{ id: 4, joints: located, skeleton: null }] }));
  assert.ok(store.positions(0, 0, "skeleton", out));
  const at = (bone) => out[3 * bones.indexOf(bone)];
  assert.equal(at("LeftForeArm"), joints.indexOf("left_elbow"));
  assert.equal(at("Hips"), (joints.indexOf("left_hip") + joints.indexOf("right_hip")) / 2);
  assert.ok(Number.isNaN(at("LeftFootEnd")));
  assert.equal(store.positions(0, 1, "skeleton", out), false);
  const skeleton = { joints: new Float32Array(3 * bones.length).fill(2) };
  assert.ok(store.add({ people: [{ id: 2, joints: located, skeleton }] }));
  assert.deepEqual(store.description.people.map(({ id }) => id), [2, 4]);
  assert.deepEqual([store.positions(0, 1, "skeleton", out), at("Hips"), store.positions(1, 1, "skeleton", out)], [true, 2, false]);
  for (let instant = 0; instant < 40; instant++) store.add({ people: [] });
  assert.deepEqual(store.description.people, []);
});
