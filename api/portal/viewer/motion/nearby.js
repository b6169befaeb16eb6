// A take in survey coordinates is drawn about an origin amid its cameras: what is drawn has single precision.

const NEAR_M = 1000;

/** World position, in whole metres, about which a take is drawn: the world's origin, unless a camera is far from it. */
export function originOf({ cameras }) {
  const centers = cameras.map(({ cam_from_world }) => centerOf(cam_from_world));
  if (centers.flat().every((value) => Math.abs(value) <= NEAR_M)) return [0, 0, 0];
  return [0, 1, 2].map((axis) => Math.round(centers.map((center) => center[axis]).sort((a, b) => a - b)[centers.length >> 1]));
}

/** Description of a motion with cameras and floor relative to an origin; records subtract its `origin_m`. */
export function about(description, origin) {
  const { cameras, floor } = description;
  return { ...description, origin_m: origin, cameras: cameras.map((camera) => moved(camera, origin)), floor: floor && lowered(floor, origin) };
}

/** Position of a camera in the world. */
export function centerOf({ rotation: r, translation_m: t }) {
  return [0, 1, 2].map((axis) => -(r[0][axis] * t[0] + r[1][axis] * t[1] + r[2][axis] * t[2]));
}

function moved(camera, origin) {
  const { rotation: r, translation_m: t } = camera.cam_from_world;
  const translation_m = t.map((value, row) => value + r[row][0] * origin[0] + r[row][1] * origin[1] + r[row][2] * origin[2]);
  return { ...camera, cam_from_world: { rotation: r, translation_m } };
}

function lowered(floor, [x, y, z]) {
  return { ...floor, height_m: floor.height_m + floor.slope_x * x + floor.slope_y * y - z };
}
