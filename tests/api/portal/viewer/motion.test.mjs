// Frames, strips and figures of a take that the export has written.

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { angleGroups, bendDeg, between, extrapolated, massCentre, speedMS, standing } from "../../../../api/portal/viewer/motion/kinematics.js";
import { about, cameraCenter, FrameRecords, chooseOrigin, parsePieces } from "../../../../api/portal/viewer/motion/records.js";
import { EditedStore, MotionStore } from "../../../../api/portal/viewer/motion/store.js";
import { bucketErrorPx, decodeStrips, spotsOf } from "../../../../api/portal/viewer/motion/strips.js";

const read = (name) => readFileSync(`${process.env.FIXTURES}/${name}`);
const description = JSON.parse(read("motion.json"));
const expected = JSON.parse(read("expected.json"));
const bytes = read("motion.bin");

/** Answer of the service for a range of frames. */
function answer(from, to) {
  const numBytes = description.record.num_bytes;
  const parts = [];
  for (const person of description.people) {
    const first = Math.max(from, person.start_frame);
    const count = Math.min(to, person.start_frame + person.num_frames) - first;
    if (count <= 0) continue;
    const start = person.offset_bytes + (first - person.start_frame) * numBytes;
    parts.push(Buffer.from(Uint32Array.from([person.id, first, count, numBytes]).buffer), bytes.subarray(start, start + count * numBytes));
  }
  const joined = Buffer.concat(parts);
  return joined.buffer.slice(joined.byteOffset, joined.byteOffset + joined.length);
}

class FakeService {
  asked = [];

  constructor(fails = 0) {
    this.fails = fails;
  }

  async frames(from, to) {
    this.asked.push([from, to]);
    if (this.fails-- > 0) throw new Error("gone");
    return answer(from, to);
  }
}

async function until(isSo) {
  for (let tries = 0; !isSo(); tries++) {
    assert.ok(tries < 1000, `in vain: ${isSo}`);
    await new Promise((resolve) => { setTimeout(resolve, 1); });
  }
}

test("records hold what the pipeline wrote", () => {
  const records = new FrameRecords(description);
  const buffer = answer(0, description.num_frames);
  const pieces = parsePieces(buffer);
  assert.deepEqual(pieces.map(({ id, firstFrame, numFrames }) => [id, firstFrame, numFrames]), [[1, 0, 40], [4, 30, 60]]);
  const place = { buffer, start: pieces[1].start + expected.row * records.numBytes };
  for (const field of ["joints", "skeleton"]) {
    const out = records.positions(place, field, description.people[1].position_step_m, new Float32Array(3 * records.count(field)));
    expected[field].flat().forEach((value, number) => {
      if (value === null) assert.ok(Number.isNaN(out[number]));
      else assert.ok(Math.abs(out[number] - value) < 1e-4, `${field} ${number}`);
    });
  }
  assert.deepEqual(expected.sources.map((_, joint) => records.source(place, joint)), expected.sources);
  assert.deepEqual(expected.sources.map((_, joint) => records.views(place, joint)), expected.views);
  assert.deepEqual(description.cameras.map((_, camera) => records.cameraErrorPx(place, camera)), [0, 5, NaN]);
  assert.equal(records.identity(place), 153 / 255);
  assert.equal(expected.angles_deg.length, description.angle_names.length);
  expected.angles_deg.forEach((value, number) => {
    const found = records.angleDeg(place, number);
    if (value === null) assert.ok(Number.isNaN(found), description.angle_names[number]);
    else assert.ok(Math.abs(found - value) <= 0.051, `${description.angle_names[number]} ${found} ${value}`);
  });
  // The person's left wrist is unknown in this frame, the right one is not.
  const known = (name) => expected.angles_deg[description.angle_names.indexOf(name)] !== null;
  assert.ok(!known("left_elbow_flexion") && known("right_elbow_flexion"));
});

test("joint angles have a plot for each part of the body, with both sides", () => {
  const groups = angleGroups(["pelvis_tilt", "left_hip_flexion", "left_ankle_dorsiflexion", "left_subtalar_inversion", "right_hip_flexion", "right_ankle_dorsiflexion"]);
  assert.deepEqual(groups.map(({ name }) => name), ["pelvis", "hip", "ankle"]);
  assert.deepEqual(groups[1].angles, [{ label: "left hip flexion", number: 1 }, { label: "right hip flexion", number: 4 }]);
  assert.deepEqual(groups[2].angles.map(({ number }) => number), [2, 3, 5]);
  assert.deepEqual(angleGroups([]), []);
});

test("a cut answer is refused", () => {
  assert.throws(() => parsePieces(answer(0, 100).slice(0, 1000)), /cut short/);
});

test("pieces are fetched once, with the one after", async () => {
  const service = new FakeService();
  const store = new MotionStore({ ...description }, service);
  store.pieceFrames = 25;
  store.want(30);
  store.want(31);
  await until(() => store.has(30) && store.has(60));
  assert.deepEqual(service.asked, [[25, 50], [50, 75]]);
  assert.ok(store.has(30) && !store.has(10));
  const out = new Float32Array(3 * store.records.numJoints);
  assert.ok(!store.positions(1, 10, "joints", out));
  assert.ok(!store.positions(0, 45, "joints", out), "the first person has left");
  assert.ok(store.positions(1, 30 + expected.row, "joints", out));
  assert.ok(Math.abs(out[0] - expected.joints[0][0]) < 1e-4);
});

test("memory is bounded: the pieces used last stay", async () => {
  const large = { ...description, num_frames: 10_000, people: [{ ...description.people[0], start_frame: 0, num_frames: 10_000 }] };
  const frameBytes = description.record.num_bytes;
  const service = { frames: async (from, to) => {
    const buffer = new ArrayBuffer(16 + (to - from) * frameBytes + 20 * 2 ** 20);
    new Uint32Array(buffer, 0, 4).set([1, from, to - from, frameBytes]);
    // A second person's frames make the piece large.
    new Uint32Array(buffer, 16 + (to - from) * frameBytes, 4).set([9, from, 1, 20 * 2 ** 20 - 16]);
    return buffer;
  } };
  const store = new MotionStore(large, service);
  store.pieceFrames = 100;
  for (let frame = 9900; frame >= 9000; frame -= 100) {
    store.want(frame);
    await until(() => store.has(frame));
  }
  assert.ok(store.numBytes <= 64 * 2 ** 20);
  assert.ok(store.has(9000) && !store.has(9900));
});

test("a failed answer is told, and asked for again later", async () => {
  const service = new FakeService(2);
  const store = new MotionStore(description, service);
  const told = new Promise((resolve) => { store.addEventListener("problem", resolve, { once: true }); });
  store.want(0);
  await told;
  assert.equal(store.problem.message, "gone");
  store.want(0);
  assert.equal(service.asked.length, 1, "not at once");
});

test("strips and spots", () => {
  const strips = decodeStrips(description, 1);
  assert.equal(strips.measured.length, 100);
  assert.equal(bucketErrorPx(description, strips, 45), 2.5);
  assert.ok(Number.isNaN(bucketErrorPx(description, strips, 95)));
  const concern = (person, kind, start_frame, stop_frame) => ({ person, kind, message: kind, start_frame, stop_frame });
  const concerns = [concern(4, "sides", 50, 52), concern(1, "error", 3, 9), concern(4, "error", 30, 40)];
  assert.deepEqual(spotsOf({ ...description, concerns }, 1), [30, 50]);
});

test("angles and speeds", () => {
  const straight = Float32Array.from([0, 0, 0, 0, 0, 1, 0, 0, 3]);
  const right = Float32Array.from([0, 0, 0, 0, 0, 1, 2, 0, 1]);
  assert.equal(bendDeg(straight, 0, 1, 2), 0);
  assert.ok(Math.abs(bendDeg(right, 0, 1, 2) - 90) < 1e-4);
  assert.ok(Number.isNaN(bendDeg(Float32Array.from([NaN, 0, 0, 0, 0, 1, 2, 0, 1]), 0, 1, 2)));
  assert.ok(Math.abs(speedMS(straight, right, 2, 0.5) - Math.hypot(2, 2) / 0.5) < 1e-6);
  assert.deepEqual([...between(straight, right, 0.5, new Float32Array(9))], [0, 0, 0, 0, 0, 1, 1, 0, 2]);
  assert.ok(standing([[0, 0, 10, 5]], 0, 14) && !standing([[0, 0, 10, 5]], 0, 15) && !standing([[0, 0, 10, 5]], 1, 12));
});

// People of the fixtures as found: person 1 in frames 0 to 39, person 4 in frames 30 to 89 of 90 or more.
const NUM_FRAMES = description.num_frames;
const piece = (person, start_frame, stop_frame) => ({ person, start_frame, stop_frame });
const peopleOf = (people, [start_frame, stop_frame] = [0, NUM_FRAMES]) => ({
  start_frame, stop_frame, first_frame: 0, edits: [], outcomes: [], people: people.map(([id, name, ...pieces]) => ({ id, name, color: `#00000${id}`, pieces })),
});
const FOUND = peopleOf([[1, "person-1", piece(1, 0, 40)], [4, "person-4", piece(4, 30, 90)]]);

async function edited(after, before = FOUND) {
  const base = new MotionStore(description, new FakeService());
  base.want(0);
  await until(() => base.has(0) && base.has(NUM_FRAMES - 1));
  return [new EditedStore(base, before, after), base];
}

function firstJoint(store, person, frame) {
  const out = new Float32Array(3 * store.records.numJoints);
  return store.positions(person, frame, "joints", out) ? [...out.slice(0, 3)] : null;
}

test("a rename changes the name alone", async () => {
  const [store] = await edited(peopleOf([[1, "Anna", piece(1, 0, 40)], [4, "person-4", piece(4, 30, 90)]]));
  const plain = structuredClone(description);
  plain.people[0].name = "Anna";
  for (const person of plain.people) person.color = `#00000${person.id}`;
  assert.deepEqual(store.description, plain);
});

test("people of edits are put together from those of the files", async () => {
  // Person 1 is split at frame 20; the second half, person 5, is exchanged with person 4 from frame 35 on.
  const [store, base] = await edited(peopleOf([
    [1, "person-1", piece(1, 0, 20)], [4, "person-4", piece(4, 30, 35), piece(1, 35, 40)], [5, "Eve", piece(1, 20, 35), piece(4, 35, 90)],
  ]));
  const { people, num_frames: numFrames } = store.description;
  assert.equal(numFrames, NUM_FRAMES);
  assert.deepEqual(people.map(({ id, name, start_frame: start, num_frames: count }) => [id, name, start, count]), [[1, "person-1", 0, 20], [4, "person-4", 30, 10], [5, "Eve", 20, 70]]);
  assert.deepEqual(firstJoint(store, 2, 34), firstJoint(base, 0, 34));
  assert.deepEqual(firstJoint(store, 2, 35), firstJoint(base, 1, 35));
  assert.deepEqual(firstJoint(store, 1, 35), firstJoint(base, 0, 35));
  assert.equal(firstJoint(store, 0, 20), null);
  // Files of a character are those of the people as they were.
  assert.deepEqual([[2, 34], [2, 35], [1, 35], [0, 20]].map(([person, frame]) => store.filed(person, frame)), [{ id: 1, frame: 34 }, { id: 4, frame: 35 }, { id: 1, frame: 35 }, null]);
  // What is known with the new files only is not claimed; strips are those of the frames.
  assert.equal(people[2].coverage, null);
  const strips = decodeStrips(store.description, 2);
  const [one, other] = [0, 1].map((person) => decodeStrips(description, person));
  assert.equal(strips.measured[34], one.measured[34]);
  assert.equal(strips.cameras[60], other.cameras[60]);
  assert.equal(strips.cameras[10], 0);
  assert.ok(Number.isNaN(bucketErrorPx(store.description, strips, 10)));
  for (const [side, part, first, count] of people[2].contacts) assert.ok(side <= 1 && part <= 2 && first >= 20 && first + count <= 90);
});

test("a cut numbers the frames anew, and people outside of it are gone", async () => {
  const [store, base] = await edited(peopleOf([[1, "person-1", piece(1, 0, 40)], [4, "person-4", piece(4, 30, 90)]], [50, 80]));
  assert.deepEqual([store.description.num_frames, store.description.first_frame], [30, 50]);
  assert.equal(store.description.first_source_frame, description.first_source_frame + 50);
  assert.deepEqual(store.filed(0, 0), { id: 4, frame: 50 });
  assert.equal(store.description.start_time_s, description.start_time_s + 50 / description.frame_rate_hz);
  assert.deepEqual(store.description.people.map(({ id, start_frame: start, num_frames: count }) => [id, start, count]), [[4, 0, 30]]);
  assert.deepEqual(firstJoint(store, 0, 3), firstJoint(base, 1, 53));
  assert.equal(store.description.people[0].identity.doubts.length, 0);
});

test("places that were accepted, and of people who changed, are left out", async () => {
  const concern = (person, start_frame, camera) => ({ person, camera, kind: "sides", message: "", start_frame, stop_frame: start_frame + 5 });
  const base = new MotionStore({ ...description, concerns: [concern(1, 15), concern(4, 40), concern(4, 60), concern(4, 80), concern(null, 50, "left"), concern(null, 60, "right")] }, new FakeService());
  const after = { ...peopleOf([[1, "a", piece(1, 0, 20)], [5, "b", piece(1, 20, 40)], [4, "c", piece(4, 30, 90)]], [50, 90]), first_frame: 1000 };
  after.edits = [{ action: "accept", kind: "sides", person: { frame: 1060, place_m: [0, 0, 0] }, start_frame: 1060, stop_frame: 1065 }, { action: "accept", kind: "error", person: 4, start_frame: 1080, stop_frame: 1085 },
    { action: "accept", kind: "sides", person: null, camera: "left", start_frame: 1000, stop_frame: 1090 }];
  after.outcomes = [{ person: 4 }, { person: 4 }, { person: null }];
  const { concerns } = new EditedStore(base, FOUND, after).description;
  assert.deepEqual(concerns.map(({ person, camera, start_frame: start }) => [person ?? camera, start]), [[4, 30], ["right", 10]]);
});

test("frames that an earlier cut left out are not waited for", async () => {
  const whole = peopleOf([[1, "person-1", piece(1, 0, 40)], [4, "person-4", piece(4, 0, 100 + NUM_FRAMES)]], [0, 100 + NUM_FRAMES]);
  const before = peopleOf([[4, "person-4", piece(4, 0, 100 + NUM_FRAMES)]], [100, 100 + NUM_FRAMES]);
  const [store, base] = await edited(whole, before);
  assert.ok(store.has(10) && firstJoint(store, 0, 10) === null);
  assert.deepEqual(firstJoint(store, 0, 140), firstJoint(base, 1, 40));
});

test("frames that come are told", async () => {
  const base = new MotionStore(description, new FakeService());
  const store = new EditedStore(base, FOUND, FOUND);
  let numLoads = 0;
  store.addEventListener("load", () => { numLoads += 1; });
  await base.loaded(5);
  assert.ok(store.has(5) && numLoads >= 1);
  store.close();
  base.dispatchEvent(new Event("load"));
  assert.equal(numLoads, 1);
});

test("a take in survey coordinates is drawn about an origin amid its cameras", () => {
  assert.deepEqual(chooseOrigin(description), [0, 0, 0]);
  const away = [500123.25, 5412345.5, 312.75];
  // The world moves the other way: cameras and floor are where a survey has them.
  const { origin_m: _, ...far } = about({ ...description, floor: { height_m: 0.1, slope_x: 0.01, slope_y: -0.02 } }, away.map((value) => -value));
  const origin = chooseOrigin(far);
  assert.ok(origin.every((value, axis) => Number.isInteger(value) && Math.abs(value - away[axis]) < 20), `${origin}`);
  const near = about(far, origin);
  near.cameras.forEach(({ cam_from_world }, number) => {
    const expectedCenter = cameraCenter(description.cameras[number].cam_from_world);
    cameraCenter(cam_from_world).forEach((value, axis) => assert.ok(Math.abs(value - (expectedCenter[axis] + away[axis] - origin[axis])) < 1e-6));
  });
  const heightAt = ({ height_m, slope_x, slope_y }, [x, y]) => height_m + slope_x * x + slope_y * y;
  const place = [away[0] - origin[0] + 2, away[1] - origin[1] - 3];
  assert.ok(Math.abs(heightAt(near.floor, place) - (0.1 + 0.02 + 0.06 + away[2] - origin[2])) < 1e-6);
  // A record holds where its positions begin in single precision, and steps of a fraction of a millimetre from there.
  const { num_bytes: numBytes, offsets, absent } = description.record;
  const record = new DataView(new ArrayBuffer(numBytes));
  [500123.5, 5412346, 313].forEach((value, axis) => record.setFloat32(offsets.origin_m + 4 * axis, value, true));
  for (let number = 0; number < 3 * description.joint_names.length; number++) record.setInt16(offsets.joints + 2 * number, number < 3 ? 7 + number : absent, true);
  const positions = new FrameRecords(near).positions({ buffer: record.buffer, start: 0 }, "joints", 1e-4, new Float32Array(3 * description.joint_names.length));
  [500123.5, 5412346, 313].forEach((value, axis) => assert.ok(Math.abs(positions[axis] - (value - origin[axis] + (7 + axis) * 1e-4)) < 1e-5));
  assert.ok(positions.slice(3).every(Number.isNaN));
});

test("centre of mass, and extrapolated centre of a body that falls evenly", () => {
  assert.deepEqual(massCentre([0.25, 0, 0.75], [0, 0, 0, NaN, NaN, NaN, 4, 8, 12]), [3, 6, 9]);
  assert.ok(Number.isNaN(massCentre([0.5, 0.5], [0, 0, 0, NaN, 0, 0])[0]));
  // A pendulum of 0.981 m swings with the square root of 10 in a second: 2.5 m/s reach 0.79 m.
  const [x, y] = extrapolated((frame) => [0.1 * frame, 1, 0.981], 7, [0.7, 1, 0], 25);
  assert.ok(Math.abs(x - (0.7 + 2.5 * Math.sqrt(0.1))) < 1e-12);
  assert.equal(y, 1);
});
