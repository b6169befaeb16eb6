// Lines of sight, `{ origin, direction }` of unit length, and points near them, as lists of three numbers in metres.

import { cameraCenter } from "../../viewer/motion/records.js";
import { prepareLens } from "../../viewer/video/overlay.js";

const dot = (one, other) => one.reduce((sum, value, axis) => sum + value * other[axis], 0);
const minus = (one, other) => one.map((value, axis) => value - other[axis]);
const at = ({ origin, direction }, distance) => origin.map((value, axis) => value + distance * direction[axis]);

/** Line through two points. */
export function through(origin, point) {
  const way = minus(point, origin);
  const length = Math.hypot(...way);
  return { origin, direction: way.map((value) => value / length) };
}

/** Line of sight of a camera through a pixel. */
export function cameraSight(camera, u, v) {
  const origin = cameraCenter(camera.cam_from_world);
  return through(origin, prepareLens(camera).ray(u, v).map((value, axis) => origin[axis] + value));
}

/** Point of a line nearest to a point. */
export const foot = (line, point) => at(line, dot(minus(point, line.origin), line.direction));

/** Point of a line nearest to another line; null if they are parallel. */
export function nearestOn(line, other) {
  const cosine = dot(line.direction, other.direction);
  const between = minus(other.origin, line.origin);
  const sine2 = 1 - cosine * cosine;
  return sine2 < 1e-9 ? null : at(line, (dot(between, line.direction) - cosine * dot(between, other.direction)) / sine2);
}

/** Point amid two lines where they are nearest to each other; null if they are parallel. */
export function meet(line, other) {
  const [one, two] = [nearestOn(line, other), nearestOn(other, line)];
  return one && one.map((value, axis) => (value + two[axis]) / 2);
}

/** Point at which a line meets the plane through a point with a normal. */
export function onPlane(line, point, normal) {
  return at(line, dot(minus(point, line.origin), normal) / dot(line.direction, normal));
}
