// The 3D view as a whole: ground, cameras, people and names.

import * as THREE from "../../vendor/three/three.module.js";
import { CharacterFigures } from "./characters.js";
import { Labels } from "./labels.js";
import { PeopleFigures } from "./people.js";
import { CameraFrustums } from "./rig.js";
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
    for (const name of this.names) this.labels.remove(name);
    this.#add(store);
    Object.assign(this.people.options, options);
  }

  #add(store) {
    this.people = new PeopleFigures(this.stage, store, this.characters);
    this.names = store.description.people.map(({ name, color }, number) => this.labels.add(name, this.people.anchors[number], { color, kind: "person" }));
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

  /** Put everybody where they are in a frame; null: nobody is there. */
  show(frame) {
    this.#frame = frame ?? -1;
    this.people.show(this.#frame);
  }

  /** Look at the people of the frame, or at the cameras if there are none: from a named direction, or as before. */
  fit(direction = null) {
    this.see(null);
    this.#fit(DIRECTIONS[direction] ?? null);
  }

  /** See through a camera; null: orbit again. */
  see(number) {
    this.seen = number;
    if (number === null) this.stage.leaveCamera();
    else this.stage.lookThrough(this.cameras[number]);
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
    this.show(this.#frame);
  }

  /** Draw if something has changed. */
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
