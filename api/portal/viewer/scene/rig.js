// Cameras of the capture in 3D: a frustum each, all in one draw call.

import * as THREE from "../../vendor/three/three.module.js";
import { centerOf } from "../motion/nearby.js";

const DEPTH_M = 0.45;
const TINT = [0.56, 0.65, 0.62];
const CHOSEN_TINT = [0.98, 0.82, 0.35];

export class CameraFrustums {
  #cameras;

  constructor(stage, cameras) {
    this.stage = stage;
    this.#cameras = cameras;
    this.centers = cameras.map(({ cam_from_world }) => new THREE.Vector3(...centerOf(cam_from_world)));
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.Float32BufferAttribute(cameras.flatMap(outline), 3));
    geometry.setAttribute("color", new THREE.Float32BufferAttribute(new Float32Array(geometry.getAttribute("position").count * 3), 3));
    this.lines = new THREE.LineSegments(geometry, new THREE.LineBasicMaterial({ vertexColors: true }));
    stage.scene.add(this.lines);
    this.choose(null);
  }

  /** Show or hide all cameras. */
  setShown(isShown) {
    this.lines.visible = isShown;
    this.stage.invalidate();
  }

  /** Show a camera in another colour; null for none. */
  choose(chosen) {
    const colors = this.lines.geometry.getAttribute("color");
    const each = colors.count / Math.max(1, this.#cameras.length);
    for (let vertex = 0; vertex < colors.count; vertex++) {
      colors.setXYZ(vertex, ...(Math.floor(vertex / each) === chosen ? CHOSEN_TINT : TINT));
    }
    colors.needsUpdate = true;
    this.stage.invalidate();
  }
}

/** Lines of a frustum: four edges, the picture's border, and a mark at its upper side. */
function outline({ matrix, size_px: [width, height], cam_from_world: pose }) {
  const center = centerOf(pose);
  const { rotation: r } = pose;
  const world = (u, v) => {
    const inCam = [((u - matrix[0][2]) / matrix[0][0]) * DEPTH_M, ((v - matrix[1][2]) / matrix[1][1]) * DEPTH_M, DEPTH_M];
    return [0, 1, 2].map((axis) => center[axis] + r[0][axis] * inCam[0] + r[1][axis] * inCam[1] + r[2][axis] * inCam[2]);
  };
  const corners = [[0, 0], [width, 0], [width, height], [0, height]].map(([u, v]) => world(u, v));
  const lines = corners.flatMap((corner, number) => [center, corner, corner, corners[(number + 1) % 4]]);
  const tip = world(width / 2, -0.25 * height);
  lines.push(corners[0], tip, tip, corners[1]);
  return lines.flat();
}
