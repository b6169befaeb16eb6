// Skeletons over a camera's picture, by the camera's own lens.

import { graphics } from "../dom.js";

const OUTLINE = "rgb(0 0 0 / 0.65)";

export class SkeletonDrawing {
  #context;
  #lens;
  #bones;
  #size;
  #pixels;

  constructor(canvas, camera, description) {
    this.canvas = canvas;
    // A canvas that is read often is drawn by the processor: without a graphics card this is many times faster.
    this.#context = canvas.getContext("2d", { willReadFrequently: graphics().isSoftware });
    this.#lens = prepareLens(camera);
    this.#size = camera.size_px;
    this.#bones = description.bones.map((bone) => bone.map((name) => description.joint_names.indexOf(name)));
    this.#pixels = new Float64Array(2 * description.joint_names.length);
  }

  /** Size of the canvas in pixels: the size of its place in the page, as measured by `measure`. */
  get size() {
    return [this.canvas.width, this.canvas.height];
  }

  /** Give the canvas the size of its place in the page. */
  measure() {
    const ratio = Math.min(2, globalThis.devicePixelRatio || 1);
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight].map((length) => Math.round(length * ratio));
    if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, { width, height });
  }

  /** Begin a picture, from an `ImageData` of the canvas' size or empty; returns the size of a pixel of the camera in pixels of the canvas. */
  begin(picture = null) {
    if (picture !== null) this.#context.putImageData(picture, 0, 0);
    else this.#context.clearRect(0, 0, this.canvas.width, this.canvas.height);
    return this.canvas.width / this.#size[0];
  }

  /** Draw a person's joints, positions in metres. */
  draw(positions, color, scale) {
    const pixels = this.#project(positions);
    const context = this.#context;
    const width = Math.max(1.5, this.canvas.width / 260);
    context.lineCap = "round";
    // The dark line below keeps the bright one visible on any picture.
    for (const [style, thickness] of [[OUTLINE, width + 2], [color, width]]) {
      context.strokeStyle = style;
      context.lineWidth = thickness;
      context.beginPath();
      for (const [from, to] of this.#bones) {
        if (!this.#isNear(pixels, from) || !this.#isNear(pixels, to)) continue;
        // Pixel (0, 0) is the centre of the first pixel, half a pixel from the canvas' corner.
        context.moveTo((pixels[2 * from] + 0.5) * scale, (pixels[2 * from + 1] + 0.5) * scale);
        context.lineTo((pixels[2 * to] + 0.5) * scale, (pixels[2 * to + 1] + 0.5) * scale);
      }
      context.stroke();
    }
  }

  #project(positions) {
    const out = [0, 0];
    for (let joint = 0; joint < this.#pixels.length / 2; joint++) {
      this.#lens.project(positions[3 * joint], positions[3 * joint + 1], positions[3 * joint + 2], out);
      this.#pixels[2 * joint] = out[0];
      this.#pixels[2 * joint + 1] = out[1];
    }
    return this.#pixels;
  }

  /** True if a point is at most one picture's size outside: farther away, lens models fold over. */
  #isNear(pixels, joint) {
    return [0, 1].every((axis) => {
      const value = pixels[2 * joint + axis];
      return value > -this.#size[axis] && value < 2 * this.#size[axis];
    });
  }
}

// Projection of world points to pixels, distortion included: the models of pipeline/geometry/camera.py and lenses/fisheye.py.

const MIN_DEPTH_M = 1e-6;
const MAX_ANGLE_RAD = (85 * Math.PI) / 180;
const TINY = 1e-9;
const [REACH_STEP, MAX_REACH] = [0.01, 12];
const [NEWTON_ROUNDS, SLOPE_STEP] = [12, 1e-6];
const SCAN_STEPS = 2000;
const BISECTIONS = 50;

/**
 * Prepared projection of a camera of the description.
 *
 * `project(x, y, z, out)` writes pixels, NaN where it sees nothing. `reach` is the distance from the axis, at depth 1, up to
 * which the model holds in and around the picture. `ray(u, v)` is the direction in the world of what a pixel shows.
 */
export function prepareLens(camera) {
  const { rotation: r, translation_m: t } = camera.cam_from_world;
  const [[fx, skew, cx], [skewY, fy, cy]] = camera.matrix;
  const bend = camera.lens === "fisheye" ? fisheye(camera.distortion) : standard(camera.distortion);
  const bent = [0, 0];
  return {
    reach: findReach(bend, camera),
    ray(u, v) {
      const y = (v - cy - (skewY / fx) * (u - cx)) / (fy - (skewY * skew) / fx);
      const [a, b] = straighten(bend, (u - cx - skew * y) / fx, y);
      return [0, 1, 2].map((axis) => r[0][axis] * a + r[1][axis] * b + r[2][axis]);
    },
    project(x, y, z, out) {
      const depth = r[2][0] * x + r[2][1] * y + r[2][2] * z + t[2];
      if (!(depth > MIN_DEPTH_M)) {
        out[0] = out[1] = NaN;
        return out;
      }
      bend(
        (r[0][0] * x + r[0][1] * y + r[0][2] * z + t[0]) / depth,
        (r[1][0] * x + r[1][1] * y + r[1][2] * z + t[1]) / depth,
        bent,
      );
      out[0] = fx * bent[0] + skew * bent[1] + cx;
      out[1] = skewY * bent[0] + fy * bent[1] + cy;
      return out;
    },
  };
}

/** Farthest distance from the axis, at depth 1, that is within a quarter of the picture's size around it; beyond, models fold over. */
function findReach(bend, { matrix, size_px: [width, height] }) {
  const farPx = [matrix[0][2], width - matrix[0][2]].map((x) => Math.hypot(x / matrix[0][0], Math.max(matrix[1][2], height - matrix[1][2]) / matrix[1][1]));
  const limit = 1.25 * Math.max(...farPx);
  const out = [0, 0];
  let [reach, radius] = [0, 0];
  for (let far = REACH_STEP; far < MAX_REACH; far += REACH_STEP) {
    bend(far, 0, out);
    if (!(out[0] > radius) || radius > limit) break;
    [reach, radius] = [far, out[0]];
  }
  return reach;
}

/** Point at depth 1 whose bent place is `(u, v)`: Newton's method with differences for slopes. */
function straighten(bend, u, v) {
  const [at, right, below] = [[0, 0], [0, 0], [0, 0]];
  let [x, y] = [u, v];
  for (let round = 0; round < NEWTON_ROUNDS; round++) {
    bend(x, y, at);
    bend(x + SLOPE_STEP, y, right);
    bend(x, y + SLOPE_STEP, below);
    const [a, b, c, d] = [right[0] - at[0], below[0] - at[0], right[1] - at[1], below[1] - at[1]].map((change) => change / SLOPE_STEP);
    const [du, dv] = [u - at[0], v - at[1]];
    const det = a * d - b * c;
    if (!(Math.abs(det) > TINY)) break;
    x += (d * du - b * dv) / det;
    y += (a * dv - c * du) / det;
  }
  return [x, y];
}

/** OpenCV's standard model with 0, 4, 5, 8 or 12 coefficients: k1, k2, p1, p2, k3, k4, k5, k6, s1 to s4. */
function standard(coefficients) {
  const [k1 = 0, k2 = 0, p1 = 0, p2 = 0, k3 = 0, k4 = 0, k5 = 0, k6 = 0, s1 = 0, s2 = 0, s3 = 0, s4 = 0] = coefficients;
  return (x, y, out) => {
    const r2 = x * x + y * y;
    const radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)));
    out[0] = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x) + r2 * (s1 + s2 * r2);
    out[1] = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y + r2 * (s3 + s4 * r2);
  };
}

/** Kannala and Brandt's fisheye with four coefficients; NaN beyond the angle up to which the radius grows. */
function fisheye([k1, k2, k3, k4]) {
  const limitRad = angleLimitRad([k1, k2, k3, k4]);
  return (x, y, out) => {
    const ideal = Math.hypot(x, y);
    const angle = Math.atan(ideal);
    const a2 = angle * angle;
    const radius = angle * (1 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4))));
    const ratio = angle > limitRad ? NaN : ideal > TINY ? radius / ideal : 1;
    out[0] = x * ratio;
    out[1] = y * ratio;
  };
}

/** First angle at which the slope of the radius is zero, at most 85 degrees. */
function angleLimitRad([k1, k2, k3, k4]) {
  const slope = (angle) => {
    const a2 = angle * angle;
    return 1 + a2 * (3 * k1 + a2 * (5 * k2 + a2 * (7 * k3 + a2 * 9 * k4)));
  };
  for (let step = 1; step <= SCAN_STEPS; step++) {
    let high = (MAX_ANGLE_RAD * step) / SCAN_STEPS;
    if (slope(high) > 0) continue;
    let low = (MAX_ANGLE_RAD * (step - 1)) / SCAN_STEPS;
    for (let half = 0; half < BISECTIONS; half++) {
      const middle = (low + high) / 2;
      if (slope(middle) > 0) low = middle;
      else high = middle;
    }
    return low;
  }
  return MAX_ANGLE_RAD;
}
