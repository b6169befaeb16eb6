// Skeletons over a camera's picture, by the camera's own lens.

import { graphics } from "../graphics.js";
import { lensOf } from "./lens.js";

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
    this.#lens = lensOf(camera);
    this.#size = camera.size_px;
    this.#bones = description.bones.map((bone) => bone.map((name) => description.joint_names.indexOf(name)));
    this.#pixels = new Float64Array(2 * description.joint_names.length);
  }

  /** Size of the canvas in pixels: that of its place in the page, as measured by `measure`. */
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

  /** Whether a point is at most one picture's size outside: farther away, lens models fold over. */
  #isNear(pixels, joint) {
    return [0, 1].every((axis) => {
      const value = pixels[2 * joint + axis];
      return value > -this.#size[axis] && value < 2 * this.#size[axis];
    });
  }
}
