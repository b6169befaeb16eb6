// Records of frames: what an answer of GET /v1/jobs/{id}/motion holds (docs/reference/file-contents.md, "Motion for viewers").

import { VIEWER } from "../../shared/strings/viewer.js";

const HEAD_BYTES = 16;
const FIELDS = { joints: "numJoints", skeleton: "numBones", forces: "numArrowEnds" };

/** Split an answer into the pieces of its people: `{ id, firstFrame, numFrames, start }`, `start` in bytes. */
export function parsePieces(buffer) {
  const pieces = [];
  const view = new DataView(buffer);
  for (let place = 0; place < buffer.byteLength;) {
    const [id, firstFrame, numFrames, numBytes] = [0, 4, 8, 12].map((offset) => view.getUint32(place + offset, true));
    const start = place + HEAD_BYTES;
    place = start + numFrames * numBytes;
    if (numBytes === 0 || place > buffer.byteLength) throw new Error(VIEWER.motionCut);
    pieces.push({ id, firstFrame, numFrames, start });
  }
  return pieces;
}

/** Reader of the records of a take. A place is `{ buffer, start }`: an answer, and the first byte of a record in it. */
export class FrameRecords {
  constructor(description) {
    const { num_bytes, offsets, absent, error_step_px, unknown_error } = description.record;
    this.numBytes = num_bytes;
    this.numJoints = description.joint_names.length;
    this.numBones = description.skeleton.names.length;
    this.numArrowEnds = 4; // tail and tip of each foot's force
    this.numCameras = description.cameras.length;
    this.offsets = offsets;
    this.absent = absent;
    this.angleStepDeg = description.record.angle_step_deg ?? null;
    this.errorStepPx = error_step_px;
    this.unknownError = unknown_error;
    this.origin = description.origin_m ?? [0, 0, 0];
  }

  /** Number of positions that a field, `joints`, `skeleton` or `forces`, holds. */
  count(field) {
    return this[FIELDS[field]];
  }

  /** Write the positions of a field, metres from the origin, to `out` (x, y, z a joint); NaN for joints without one. */
  positions({ buffer, start }, field, stepM, out) {
    // Records and their heads are multiples of four bytes, so both views are aligned.
    const root = new Float32Array(buffer, start + this.offsets.origin_m, 3);
    const steps = new Int16Array(buffer, start + this.offsets[field], 3 * this.count(field));
    for (let joint = 0; joint < steps.length; joint += 3) {
      const isAbsent = steps[joint] === this.absent;
      for (let axis = 0; axis < 3; axis++) {
        out[joint + axis] = isAbsent ? NaN : root[axis] - this.origin[axis] + steps[joint + axis] * stepM;
      }
    }
    return out;
  }

  /** Source of a joint (0 absent, 1 measured, 2 interpolated, 3 predicted). */
  source(place, joint) {
    return this.#byte(place, "source_views", joint) & 3;
  }

  /** Number of cameras that saw a joint. */
  views(place, joint) {
    return this.#byte(place, "source_views", joint) >> 2;
  }

  /** Joint angle in degrees by its number among `angle_names`; NaN where it is unknown. */
  angleDeg({ buffer, start }, number) {
    const [steps] = new Int16Array(buffer, start + this.offsets.angles + 2 * number, 1);
    return steps === this.absent ? NaN : steps * this.angleStepDeg;
  }

  /** Reprojection error of a joint in pixels; NaN without one. */
  jointErrorPx(place, joint) {
    return this.#errorPx(this.#byte(place, "error", joint));
  }

  /** Mean reprojection error of the body in a camera, in pixels; NaN where the camera sees nothing of the person. */
  cameraErrorPx(place, camera) {
    return this.#errorPx(this.#byte(place, "camera_error", camera));
  }

  /** Confidence in the person's identity, from 0 to 1. */
  identity(place) {
    return this.#byte(place, "identity", 0) / 255;
  }

  #byte({ buffer, start }, field, number) {
    return new Uint8Array(buffer, start + this.offsets[field] + number, 1)[0];
  }

  #errorPx(steps) {
    return steps === this.unknownError ? NaN : steps * this.errorStepPx;
  }
}

// A take in survey coordinates is drawn about an origin amid its cameras: what is drawn has single precision.

const NEAR_M = 1000;

/** World position, in whole metres, about which a take is drawn: the world's origin, unless a camera is far from it. */
export function chooseOrigin({ cameras }) {
  const centers = cameras.map(({ cam_from_world }) => cameraCenter(cam_from_world));
  if (centers.flat().every((value) => Math.abs(value) <= NEAR_M)) return [0, 0, 0];
  return [0, 1, 2].map((axis) => Math.round(centers.map((center) => center[axis]).sort((a, b) => a - b)[centers.length >> 1]));
}

/** Description of a motion with cameras and floor relative to an origin; records subtract its `origin_m`. */
export function about(description, origin) {
  const { cameras, floor } = description;
  return { ...description, origin_m: origin, cameras: cameras.map((camera) => moved(camera, origin)), floor: floor && lowered(floor, origin) };
}

/** Position of a camera in the world. */
export function cameraCenter({ rotation: r, translation_m: t }) {
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

// Arrays of numbers in texts of JSON.

/** Little-endian integers in base64. */
export function integers(text, Kind = Int16Array) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  return new Kind(bytes.buffer);
}
