// Orientations of a skeleton's joints from their positions, and the transforms by which they move a body's skin.
//
// Positions tell all but turns about a bone. The turns of an upper arm and of a thigh follow from the plane of the elbow or
// the knee, as in the fit (pipeline/motion/skeleton/rotations.py); of a straight leg from the foot; of the head from the face.

const SIDES = [["Left", 1], ["Right", -1]];
const ELBOW_HINGES = { Left: [0, 0, -1], Right: [0, 0, 1] };
const KNEE_HINGE = [1, 0, 0];
const FINGERS = ["Thumb", "Index", "Middle", "Ring", "Pinky"];
// Sine of the bend of a limb that is nearly straight, and weight of the turn that is usual without a bend.
const STRAIGHT_SINE = 0.15;
const USUAL_WEIGHT = 0.02;
// Share of the head's turn that the neck has.
const NECK_SHARE = 1 / 3;

/** Number of values of a joint's transform: the columns of a matrix of 4 x 4, one after the other. */
export const TRANSFORM_VALUES = 16;

/** Transforms of the joints of bodies, from positions of the skeleton's joints and of the detector's. */
export class BodyPose {
  #joints;
  #marks;
  #twists;
  #turns; // matrix of each joint, rest to world, row by row
  #middleTwist; // middle of the range of a hand's turns about the arm

  /** `body` and `joint_names` are a description's. */
  constructor({ body, joint_names: marks }) {
    this.numJoints = body.joints.length;
    this.#joints = Object.fromEntries(body.joints.map((name, number) => [name, number]));
    this.#marks = Object.fromEntries(marks.map((name, number) => [name, number]));
    this.#twists = body.twists.map(({ name, parent, hand, share }) => ({ joint: this.#joints[name], parent: this.#joints[parent], hand: this.#joints[hand], share }));
    this.#middleTwist = body.middle_twist_rad;
    this.#turns = body.joints.map(() => [1, 0, 0, 0, 1, 0, 0, 0, 1]);
  }

  /**
   * Write the transforms of all joints to `out`, from the place `start` on.
   *
   * `rest` are positions of all joints of the body at rest, `positions` of the skeleton's joints, `marks` of the
   * detector's joints, three numbers each, NaN for unknown ones.
   */
  write(rest, positions, marks, out, start) {
    this.#orient(rest, positions, marks);
    const numSkeleton = positions.length / 3;
    for (let joint = 0; joint < this.numJoints; joint++) {
      const isKnown = joint < numSkeleton && Number.isFinite(positions[3 * joint]);
      if (isKnown) writeTransform(this.#turns[joint], at(rest, joint), at(positions, joint), out, start + TRANSFORM_VALUES * joint);
    }
    this.#twistForearms(rest, positions, out, start);
    this.#keepFingers(positions, out, start);
  }

  #orient(rest, positions, marks) {
    const [joints, turns] = [this.#joints, this.#turns];
    const way = (from, to) => minus(at(positions, joints[to]), at(positions, joints[from]));
    const restWay = (from, to) => unit(minus(at(rest, joints[to]), at(rest, joints[from])));
    const swing = (name, parent, end) => { turns[joints[name]] = swung(turns[joints[parent]], restWay(name, end), unit(way(name, end))); };
    turns[joints.Hips] = fromZX(way("Hips", "Spine"), way("RightUpLeg", "LeftUpLeg"));
    turns[joints.Chest] = fromZX(way("Chest", "Neck"), way("RightArm", "LeftArm"));
    const [hips, chest] = [turns[joints.Hips], turns[joints.Chest]];
    turns[joints.Spine] = fromZX(way("Spine", "Chest"), plus(column(hips, 0), column(chest, 0)));
    this.#orientHead(way, marks, positions);
    for (const [side, sign] of SIDES) {
      const [shoulder, arm, forearm, hand] = ["Shoulder", "Arm", "ForeArm", "Hand"].map((name) => side + name);
      swing(shoulder, "Chest", arm);
      swing(arm, shoulder, forearm);
      this.#twistLimb(arm, [sign, 0, 0], ELBOW_HINGES[side], unit(way(forearm, hand)), null);
      swing(forearm, arm, hand);
      this.#orientHand(side, way, restWay, swing, positions);
      const [thigh, shank, foot, toes] = ["UpLeg", "Leg", "Foot", "FootEnd"].map((name) => side + name);
      swing(thigh, "Hips", shank);
      this.#twistLimb(thigh, [0, 0, -1], KNEE_HINGE, unit(way(shank, foot)), way(foot, toes));
      swing(shank, thigh, foot);
      swing(foot, shank, toes);
    }
  }

  #orientHead(way, marks, positions) {
    const [joints, turns] = [this.#joints, this.#turns];
    const up = way("Head", "HeadEnd");
    const chest = turns[joints.Chest];
    const straight = column(swung(chest, [0, 0, 1], unit(up)), 0);
    const left = this.#leftOfFace(unit(up), marks, at(positions, joints.Head)) ?? straight;
    turns[joints.Head] = fromZX(up, left);
    const mixed = straight.map((value, axis) => (1 - NECK_SHARE) * value + NECK_SHARE * left[axis]);
    turns[joints.Neck] = fromZX(way("Neck", "Head"), mixed);
  }

  /** Direction to the left of a face; null if the face is unknown. */
  #leftOfFace(up, marks, center) {
    const mark = (name) => (name in this.#marks ? at(marks, this.#marks[name]) : [NaN, NaN, NaN]);
    const across = minus(mark("left_ear"), mark("right_ear"));
    if (Number.isFinite(across[0])) return across;
    const left = cross(up, minus(mark("nose"), center));
    return Number.isFinite(left[0]) ? left : null;
  }

  #orientHand(side, way, restWay, swing, positions) {
    const [joints, turns] = [this.#joints, this.#turns];
    const hand = `${side}Hand`;
    const across = way(`${hand}Pinky1`, `${hand}Index1`);
    if (!Number.isFinite(across[0])) {
      swing(hand, `${side}ForeArm`, `${hand}End`);
      return;
    }
    const before = fromXY(restWay(hand, `${hand}Middle1`), restWay(`${hand}Pinky1`, `${hand}Index1`));
    turns[joints[hand]] = times(fromXY(way(hand, `${hand}Middle1`), across), transposed(before));
    for (const finger of FINGERS) {
      const names = [hand, ...["1", "2", "3", "3End"].map((part) => hand + finger + part)];
      for (let part = 1; part < 4; part++) swing(names[part], names[part - 1], names[part + 1]);
    }
  }

  /**
   * Turn a limb about its own bone so that its hinge bends the next one, whose direction is `lower`.
   *
   * `bone` and `hinge` are directions at rest. `ahead` points to the front where the limb is straight, null: unknown.
   */
  #twistLimb(name, bone, hinge, lower, ahead) {
    const joint = this.#joints[name];
    const turn = this.#turns[joint];
    const normal = cross(bone, rotatedBack(turn, lower));
    const [real, imaginary] = [dot(normal, hinge), dot(normal, cross(bone, hinge))];
    const sine = Math.hypot(real, imaginary);
    // Neither elbows nor knees bend backwards.
    const weight = sine > 0 ? ((sine ** 4 / (sine ** 2 + STRAIGHT_SINE ** 2)) * (1 + real / sine)) / 2 : 0;
    const usual = ahead === null ? [1, 0] : direction2(turn, bone, ahead);
    const share = sine > 0 ? weight / sine : 0;
    const angle = Math.atan2(share * imaginary + USUAL_WEIGHT * usual[1], share * real + USUAL_WEIGHT * usual[0]);
    this.#turns[joint] = times(turn, about(bone, angle));
  }

  #twistForearms(rest, positions, out, start) {
    for (const { joint, parent, hand, share } of this.#twists) {
      const turn = times(transposed(this.#turns[parent]), this.#turns[hand]);
      const angle = wrapped(twistAboutX(turn) - this.#middleTwist) + this.#middleTwist;
      const between = (values) => at(values, parent).map((value, axis) => value + share * (values[3 * hand + axis] - value));
      const twisted = times(this.#turns[parent], about([1, 0, 0], share * angle));
      writeTransform(twisted, at(rest, joint), between(positions), out, start + TRANSFORM_VALUES * joint);
    }
  }

  /** Move fingers without positions with their hands. */
  #keepFingers(positions, out, start) {
    for (const [side] of SIDES) {
      const hand = start + TRANSFORM_VALUES * this.#joints[`${side}Hand`];
      for (const [name, joint] of Object.entries(this.#joints)) {
        const isFinger = name.startsWith(`${side}Hand`) && joint < this.numJoints - this.#twists.length;
        if (!isFinger || Number.isFinite(positions[3 * joint])) continue;
        out.copyWithin(start + TRANSFORM_VALUES * joint, hand, hand + TRANSFORM_VALUES);
      }
    }
  }
}

const at = (values, joint) => [values[3 * joint], values[3 * joint + 1], values[3 * joint + 2]];
const plus = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const column = (m, axis) => [m[axis], m[3 + axis], m[6 + axis]];
const transposed = (m) => [m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8]];
const rotated = (m, v) => [dot(m.slice(0, 3), v), dot(m.slice(3, 6), v), dot(m.slice(6, 9), v)];
const rotatedBack = (m, v) => rotated(transposed(m), v);
const wrapped = (rad) => rad - 2 * Math.PI * Math.round(rad / (2 * Math.PI));

function unit(v) {
  const length = Math.hypot(...v);
  return length > 0 ? v.map((value) => value / length) : v;
}

function times(a, b) {
  const rows = [0, 3, 6].map((row) => [a[row], a[row + 1], a[row + 2]]);
  const columns = [0, 1, 2].map((axis) => column(b, axis));
  return rows.flatMap((row) => columns.map((values) => dot(row, values)));
}

const fromAxes = (x, y, z) => [x[0], y[0], z[0], x[1], y[1], z[1], x[2], y[2], z[2]];

/** Rotation with the z axis along a direction, and the x axis as close to another one as possible. */
function fromZX(along, near) {
  const z = unit(along);
  const y = unit(cross(z, near));
  return fromAxes(cross(y, z), y, z);
}

/** Rotation with the x axis along a direction, and the y axis as close to another one as possible. */
function fromXY(along, near) {
  const x = unit(along);
  const z = unit(cross(x, near));
  return fromAxes(x, cross(z, x), z);
}

/** Rotation by an angle about a unit vector. */
function about([x, y, z], angle) {
  const [sine, cosine] = [Math.sin(angle), Math.cos(angle)];
  const rest = 1 - cosine;
  return [
    cosine + x * x * rest, x * y * rest - z * sine, x * z * rest + y * sine,
    x * y * rest + z * sine, cosine + y * y * rest, y * z * rest - x * sine,
    x * z * rest - y * sine, y * z * rest + x * sine, cosine + z * z * rest,
  ];
}

/** A rotation of which a direction at rest is turned to another one, in the shortest way. */
function swung(turn, atRest, direction) {
  const now = rotated(turn, atRest);
  const axis = cross(now, direction);
  const sine = Math.hypot(...axis);
  if (!(sine > 1e-9)) return turn;
  return times(about(axis.map((value) => value / sine), Math.atan2(sine, dot(now, direction))), turn);
}

/** Cosine and sine, times the length, of the turn about a bone that brings the front to a direction. */
function direction2(turn, bone, ahead) {
  const front = [0, -1, 0];
  const local = unit(rotatedBack(turn, ahead));
  return [dot(local, front), dot(local, cross(bone, front))];
}

/** Turn of a rotation about the x axis. */
function twistAboutX(m) {
  // Components x and w of the quaternion, times a factor that both have: the larger of two ways to compute them.
  const [w, x] = 1 + m[0] + m[4] + m[8] > 1 + m[0] - m[4] - m[8] ? [1 + m[0] + m[4] + m[8], m[7] - m[5]] : [m[7] - m[5], 1 + m[0] - m[4] - m[8]];
  return 2 * Math.atan2(x, w);
}

function writeTransform(turn, from, to, out, start) {
  const shift = minus(to, rotated(turn, from));
  for (let axis = 0; axis < 3; axis++) {
    const place = start + 4 * axis;
    [out[place], out[place + 1], out[place + 2], out[place + 3]] = [turn[axis], turn[3 + axis], turn[6 + axis], 0];
  }
  [out[start + 12], out[start + 13], out[start + 14], out[start + 15]] = [...shift, 1];
}
