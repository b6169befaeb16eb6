// Lines of sight, and the preview of corrected joints.

import assert from "node:assert/strict";
import { test } from "node:test";
import { cameraSight, foot, meet, nearestOn, onPlane, through } from "../../../../api/portal/jobs/corrections/lines.js";
import { JointTree, Preview } from "../../../../api/portal/jobs/corrections/moved_joints.js";

const close = (found, expected) => found.forEach((value, axis) => assert.ok(Math.abs(value - expected[axis]) < 1e-6, `${found} is not ${expected}`));
const MARKS = ["nose", "left_shoulder", "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist", "left_thumb_1", "left_knee", "right_knee"];
const BONES = ["Hips", "LeftArm", "LeftForeArm", "LeftHand", "LeftHandEnd", "RightForeArm"];
const description = { joint_names: MARKS, skeleton: { names: BONES, parents: [null, 0, 1, 2, 3, 0] }, frame_rate_hz: 20 };

test("lines of two cameras meet at the point that both see", () => {
  const point = [0.3, 4, 1.2];
  const sights = [[-2, 0, 1], [3, 0.5, 2]].map((center) => through(center, point));
  close(meet(...sights), point);
  close(nearestOn(sights[0], sights[1]), point);
  assert.equal(meet(sights[0], { ...sights[0], origin: [0, 0, 5] }), null);
  close(foot({ origin: [0, 0, 0], direction: [1, 0, 0] }, [2, 3, 4]), [2, 0, 0]);
  close(onPlane({ origin: [0, 0, 0], direction: [0.6, 0.8, 0] }, [3, 9, 9], [1, 0, 0]), [3, 4, 0]);
});

test("a camera sees along the ray of a pixel", () => {
  const camera = {
    matrix: [[800, 0, 320], [0, 800, 240], [0, 0, 1]], distortion: [-0.2, 0.05, 0, 0], lens: "standard", size_px: [640, 480],
    cam_from_world: { rotation: [[1, 0, 0], [0, 0, -1], [0, 1, 0]], translation_m: [0, 1, 2] },
  };
  const { origin, direction } = cameraSight(camera, 320, 240);
  close(origin, [0, -2, 1]);
  close(direction, [0, 1, 0]);
});

test("a moved wrist bends the arm, whose bones keep their lengths, and takes the hand along", () => {
  const tree = new JointTree(description);
  const positions = Float64Array.from([0, 0, 0, 0, 0, 1, 0.3, 0, 0.9, 0.5, 0.1, 0.8, 0.6, 0.1, 0.8, 9, 9, 9]);
  const before = positions.slice();
  const length = (all, one, other) => Math.hypot(...[0, 1, 2].map((axis) => all[3 * one + axis] - all[3 * other + axis]));
  tree.move("skeleton", positions, "left_wrist", [-0.1, 0.05, 0.1]);
  close([...positions.slice(9, 12)], [0.4, 0.15, 0.9]);
  close([...positions.slice(12, 15)], [0.5, 0.15, 0.9]);
  for (const [one, other] of [[1, 2], [2, 3]]) assert.ok(Math.abs(length(positions, one, other) - length(before, one, other)) < 1e-9);
  assert.notDeepEqual([...positions.slice(6, 9)], [...before.slice(6, 9)]);
  assert.deepEqual([...positions.slice(15)], [9, 9, 9]);
  // Joints without a bone move in the detector's set alone.
  const same = positions.slice();
  tree.move("skeleton", positions, "nose", [1, 1, 1]);
  assert.deepEqual(positions, same);
  const marks = new Float64Array(30);
  tree.move("joints", marks, "left_elbow", [1, 0, 0]);
  assert.deepEqual([...marks].flatMap((value, place) => (value === 1 ? [MARKS[Math.floor(place / 3)]] : [])), ["left_elbow", "left_wrist", "left_thumb_1"]);
});

const store = { description, positions: (person, frame, field, out) => { out.fill(0); return person === 0; } };
const at = (preview, person, frame, joint) => {
  const positions = new Float32Array(30);
  preview.adjust(person, frame, "joints", positions);
  return positions[3 * MARKS.indexOf(joint)];
};

test("keys are held, and end within half a second", () => {
  const key = (frame, x) => ({ action: "key", person: 0, joint: "left_knee", frame, place_m: [x, 0, 0] });
  const preview = new Preview(store, [key(40, 1), key(30, 3), key(100, 2)]);
  const found = [20, 25, 30, 35, 40, 45, 50, 70, 90, 95, 100, 110].map((frame) => at(preview, 0, frame, "left_knee"));
  close(found, [0, 1.5, 3, 2, 1, 0.5, 0, 0, 0, 1, 2, 0]);
  assert.equal(at(preview, 1, 30, "left_knee"), 0);
});

test("of two keys in one frame the later counts, and sides are exchanged in their range", () => {
  const key = (x) => ({ action: "key", person: 0, joint: "left_knee", frame: 30, place_m: [x, 0, 0] });
  close([at(new Preview(store, [key(1), key(2)]), 0, 30, "left_knee")], [2]);
  const preview = new Preview(store, [{ action: "exchange_sides", person: 0, part: "arms", start_frame: 5, stop_frame: 8 }]);
  for (const [frame, isExchanged] of [[4, false], [5, true], [7, true], [8, false]]) {
    const positions = Float32Array.from(MARKS.flatMap((_, number) => [number, 0, 0]));
    preview.adjust(0, frame, "joints", positions);
    assert.deepEqual([positions[9], positions[12], positions[24]], [...(isExchanged ? [4, 3] : [3, 4]), 8], `frame ${frame}`);
  }
});
