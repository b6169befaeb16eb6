// The 3D view as a whole: ground, cameras, people and names.

import * as THREE from "../../vendor/three/three.module.js";
import { el } from "../dom.js";
import { cameraCenter } from "../motion/records.js";
import { CharacterFigures } from "./characters.js";
import { PeopleFigures } from "./people.js";
import { PointFigures } from "./points.js";
import { Canvas3D } from "./stage.js";

const OBLIQUE = new THREE.Vector3(0.55, -0.75, 0.42).normalize();
const DIRECTIONS = {
  top: new THREE.Vector3(0, -0.001, 1).normalize(),
  front: new THREE.Vector3(0, -1, 0.12).normalize(),
  side: new THREE.Vector3(1, 0, 0.12).normalize(),
};
const MARGIN_M = 0.35;

export class SceneView {
  #frame = 0;
  #hasCameras = true;

  constructor(canvas, layer, store) {
    const { description } = store;
    this.cameras = description.cameras;
    this.seen = null;
    this.stage = new Canvas3D(canvas, description.floor);
    this.rig = new CameraFrustums(this.stage, description.cameras);
    this.characters = new CharacterFigures(this.stage, description.origin_m ?? [0, 0, 0]);
    this.labels = new Labels(this.stage, layer);
    this.#add(store);
    this.cameraNames = description.cameras.map(({ name }, number) => this.labels.add(name, this.rig.centers[number], { kind: "camera" }));
  }

  /** Show the people of another store from now on; ground, cameras and the view stay. */
  replace(store) {
    const { options } = this.people;
    this.people.close();
    this.points.close();
    for (const name of [...this.names, ...this.pointNames]) this.labels.remove(name);
    this.#add(store);
    Object.assign(this.people.options, options);
  }

  #add(store) {
    this.people = new PeopleFigures(this.stage, store, this.characters);
    this.names = store.description.people.map(({ name, color }, number) => this.labels.add(name, this.people.anchors[number], { color, kind: "person" }));
    this.points = new PointFigures(this.stage, store.description);
    this.pointNames = this.points.points.map(({ name, anchor, color }) => this.labels.add(name.replaceAll("_", " "), anchor, { color, kind: "point" }));
  }

  /** First picture: the ground below everybody and all cameras, and everybody in view. */
  open(frame) {
    const around = this.people.boxAt(frame);
    this.rig.centers.forEach((center) => around.expandByPoint(new THREE.Vector3(center.x, center.y, this.stage.floorZ(center.x, center.y))));
    if (around.isEmpty()) around.set(new THREE.Vector3(-3, -3, 0), new THREE.Vector3(3, 3, 2));
    this.stage.addGround(around);
    this.show(frame);
    this.#fit(OBLIQUE);
  }

  /** Put all people where they are in a frame, or between two frames; null: no person is there. */
  show(frame) {
    this.#frame = frame ?? -1;
    this.people.show(this.#frame);
    this.points.show(this.#frame);
  }

  /** Look at the people of the frame, or at the cameras if there are none: from a named direction, or as before. */
  fit(direction = null) {
    this.see(null);
    this.#fit(DIRECTIONS[direction] ?? null);
  }

  /** See through a camera; null: orbit again. `isClear`: its picture is behind the view. */
  see(number, isClear = false) {
    this.seen = number;
    if (number === null) this.stage.leaveCamera();
    else this.stage.lookThrough(this.cameras[number], isClear);
    this.rig.choose(number);
    this.#showCameras();
  }

  /** Show what is chosen of bodies, bones, trails, contacts, cameras and names. */
  apply(options) {
    Object.assign(this.people.options, options);
    this.labels.isShown = options.names;
    this.#hasCameras = options.cameras;
    this.#showCameras();
    this.show(this.#frame);
  }

  /** Show people as `human`, `capsule` or `character`, whose files are loaded; humans are capsules where there are none. */
  showAs(shape) {
    this.people.options.shape = shape;
    this.show(this.#frame);
  }

  setShown(person, isShown) {
    this.names[person].isShown = isShown;
    this.people.setShown(person, isShown);
    this.points.setShown(person, isShown);
    this.show(this.#frame);
  }

  draw(now) {
    if (this.stage.draw(now)) this.labels.draw();
  }

  close() {
    this.characters.clear();
    this.stage.close();
  }

  #fit(direction) {
    const box = this.people.boxAt(this.#frame);
    if (box.isEmpty()) this.rig.centers.forEach((center) => box.expandByPoint(center));
    if (box.isEmpty()) box.set(new THREE.Vector3(-2, -2, 0), new THREE.Vector3(2, 2, 2));
    this.stage.fit(box.expandByScalar(MARGIN_M), direction);
  }

  #showCameras() {
    const isShown = this.#hasCameras && this.seen === null;
    this.rig.setShown(isShown);
    for (const name of this.cameraNames) name.isShown = isShown;
  }
}

// Names over the 3D view: elements of the page, so that they stay sharp and can be read aloud.

export class Labels {
  #items = [];
  #place = new THREE.Vector3();

  constructor(stage, layer) {
    this.stage = stage;
    this.layer = layer;
    this.isShown = true;
  }

  /** Add a name at a point that may move; it is hidden while the point is NaN. */
  add(text, point, { color = null, kind }) {
    const element = el("span", { class: `look-label look-label-${kind}` }, text);
    if (color) element.style.setProperty("--tint", color);
    this.layer.append(element);
    const item = { element, point, kind, isShown: true };
    this.#items.push(item);
    return item;
  }

  remove(item) {
    item.element.remove();
    this.#items = this.#items.filter((other) => other !== item);
  }

  /** Put all names where their points are in the picture. */
  draw() {
    for (const { element, point, isShown } of this.#items) {
      const isVisible = this.isShown && isShown && Number.isFinite(point.x) && this.stage.toScreen(point, this.#place);
      element.hidden = !isVisible;
      if (isVisible) element.style.transform = `translate(-50%, -100%) translate(${this.#place.x.toFixed(1)}px, ${this.#place.y.toFixed(1)}px)`;
    }
  }
}

// Cameras of the capture in 3D: a frustum each, all in one draw call.

const DEPTH_M = 0.45;
const TINT = [0.56, 0.65, 0.62];
const CHOSEN_TINT = [0.98, 0.82, 0.35];

class CameraFrustums {
  #cameras;

  constructor(stage, cameras) {
    this.stage = stage;
    this.#cameras = cameras;
    this.centers = cameras.map(({ cam_from_world }) => new THREE.Vector3(...cameraCenter(cam_from_world)));
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.Float32BufferAttribute(cameras.flatMap(outline), 3));
    geometry.setAttribute("color", new THREE.Float32BufferAttribute(new Float32Array(geometry.getAttribute("position").count * 3), 3));
    this.lines = new THREE.LineSegments(geometry, new THREE.LineBasicMaterial({ vertexColors: true }));
    stage.scene.add(this.lines);
    this.choose(null);
  }

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
  const center = cameraCenter(pose);
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
