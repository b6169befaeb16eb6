// Bends of joints and speeds from positions of the animation skeleton. Pure functions of typed arrays; NaN stays NaN.

import { FIGURES } from "../../shared/strings/viewer.js";

const bendLabel = (side, joint) => FIGURES.bends(FIGURES.bendSides[side], FIGURES.bendJoints[joint]);

/** Bends that plots offer: the angle at `at` between the bones from `from` and to `to`; 0 is straight. */
export const ANGLES = ["Left", "Right"].flatMap((side) => [
  { label: bendLabel(side, "elbow"), from: `${side}Arm`, at: `${side}ForeArm`, to: `${side}Hand` },
  { label: bendLabel(side, "knee"), from: `${side}UpLeg`, at: `${side}Leg`, to: `${side}Foot` },
  { label: bendLabel(side, "hip"), from: "Spine", at: `${side}UpLeg`, to: `${side}Leg` },
]);

/** Groups of joint angles for a plot each: name, and the angles with their numbers among `names`. */
export function angleGroups(names) {
  const groups = new Map();
  names.forEach((name, number) => {
    const [part] = name.replace(/^(left|right)_/, "").split("_");
    const group = part === "subtalar" ? "ankle" : part;
    groups.set(group, [...(groups.get(group) ?? []), { label: name.replaceAll("_", " "), number }]);
  });
  return [...groups].map(([name, angles]) => ({ name, angles }));
}

/** Joints whose speeds plots offer. */
export const SPEEDS = Object.entries(FIGURES.speedJoints);

/** Bend in degrees at the joint `at`: the angle by which the second bone leaves the first one's direction. */
export function bendDeg(positions, from, at, to) {
  let dot = 0;
  let first = 0;
  let second = 0;
  for (let axis = 0; axis < 3; axis++) {
    const a = positions[3 * at + axis] - positions[3 * from + axis];
    const b = positions[3 * to + axis] - positions[3 * at + axis];
    dot += a * b;
    first += a * a;
    second += b * b;
  }
  const cosine = dot / Math.sqrt(first * second);
  return (Math.acos(Math.min(1, Math.max(-1, cosine))) * 180) / Math.PI;
}

/** Speed of a joint in m/s between two frames that are `seconds` apart. */
export function speedMS(before, after, joint, seconds) {
  let square = 0;
  for (let axis = 0; axis < 3; axis++) square += (after[3 * joint + axis] - before[3 * joint + axis]) ** 2;
  return Math.sqrt(square) / seconds;
}

/** Mean of two sets of positions: at `share` of the way from `before` to `after`. NaN where one of both is. */
export function between(before, after, share, out) {
  for (let place = 0; place < before.length; place++) out[place] = before[place] + share * (after[place] - before[place]);
  return out;
}

/**
 * Write a person's positions at a place between two frames of a store, as its `positions` does; whether there are any.
 *
 * `next` is room for as many positions. Corrections that a store has as its `preview` are made.
 */
export function positionsAt(store, person, place, field, out, next) {
  const frame = Math.floor(place + 1e-6);
  if (!store.positions(person, frame, field, out)) return false;
  const share = place - frame;
  if (share > 1e-3 && store.positions(person, frame + 1, field, next)) between(out, next, share, out);
  store.preview?.adjust(person, place, field, out);
  return true;
}

// Time of the line that gives a velocity, and the gravity of the pendulum that a standing person is (Hof et al. 2005).
const SLOPE_S = 0.12;
const GRAVITY_M_S2 = 9.81;

/** Centre of mass of a set of joints' positions; NaN where a joint with a weight is unknown. */
export function massCentre(weights, joints, out = [0, 0, 0]) {
  for (let axis = 0; axis < 3; axis++) out[axis] = weights.reduce((sum, weight, joint) => (weight ? sum + weight * joints[3 * joint + axis] : sum), 0);
  return out;
}

/** Extrapolated centre of mass at a frame, as x and y; `centreAt` gives the centre in a frame, `ankles` their middle. */
export function extrapolated(centreAt, frame, ankles, rateHz) {
  const half = Math.max(2, Math.round((SLOPE_S * rateHz) / 2));
  const centre = centreAt(frame);
  const [slope, squares] = [[0, 0], (half * (half + 1) * (2 * half + 1)) / 3];
  for (let step = 1; step <= half; step++) {
    const [before, after] = [centreAt(frame - step), centreAt(frame + step)];
    for (const axis of [0, 1]) slope[axis] += (step * (after[axis] - before[axis]) * rateHz) / squares;
  }
  const time = Math.sqrt(Math.hypot(...centre.map((value, axis) => value - ankles[axis])) / GRAVITY_M_S2);
  return [centre[0] + time * slope[0], centre[1] + time * slope[1]];
}

/** True if a foot stands on the floor in a frame; `contacts` are the rows of a person's description. */
export function standing(contacts, side, frame) {
  return contacts.some(([ofSide, , first, count]) => ofSide === side && frame >= first && frame < first + count);
}
