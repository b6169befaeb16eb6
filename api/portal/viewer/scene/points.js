// Points of the user's own in 3D: a ball for each point of a person or of an object, and lines for bones between them.

import * as THREE from "../../vendor/three/three.module.js";
import { integers } from "../motion/records.js";

const RADIUS_M = 0.035;
const OBJECT_COLOR = "#f4f1e8";
const HIDDEN = new THREE.Matrix4().makeScale(0, 0, 0);

export class PointFigures {
  #matrix = new THREE.Matrix4();
  #absent;
  #origin;

  constructor(stage, { points = [], point_bones: bones = [], people, record = {}, origin_m: origin = [0, 0, 0] }) {
    this.stage = stage;
    this.#absent = record.absent;
    this.#origin = origin;
    this.points = points.map((point) => {
      const owner = people.findIndex(({ id }) => id === point.person);
      const color = people[owner]?.color ?? OBJECT_COLOR;
      return { ...point, owner, color, places: integers(point.positions), anchor: new THREE.Vector3(NaN, NaN, NaN), isShown: true };
    });
    this.balls = new THREE.InstancedMesh(new THREE.SphereGeometry(RADIUS_M, 16, 12), new THREE.MeshLambertMaterial(), Math.max(1, points.length));
    this.balls.count = points.length;
    this.balls.frustumCulled = false; // its bounds would have to be computed for each frame
    this.points.forEach(({ color }, number) => this.balls.setColorAt(number, new THREE.Color(color)));
    stage.add(this.balls);
    this.bones = bones;
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(6 * bones.length), 3));
    this.lines = new THREE.LineSegments(geometry, new THREE.LineBasicMaterial({ color: OBJECT_COLOR }));
    this.lines.frustumCulled = false;
    stage.add(this.lines);
  }

  setShown(person, isShown) {
    for (const point of this.points) if (point.owner === person) point.isShown = isShown;
  }

  /** Put all points where they are in the nearest frame. */
  show(place) {
    this.points.forEach((point, number) => {
      const { places, anchor, origin_m: from, position_step_m: step, start_frame: start } = point;
      const row = 3 * (Math.round(place) - start);
      const isHere = point.isShown && row >= 0 && row < places.length && places[row] !== this.#absent;
      anchor.set(...[0, 1, 2].map((axis) => (isHere ? places[row + axis] * step + from[axis] - this.#origin[axis] : NaN)));
      this.balls.setMatrixAt(number, isHere ? this.#matrix.makeTranslation(anchor) : HIDDEN);
    });
    this.balls.instanceMatrix.needsUpdate = true;
    const ends = this.lines.geometry.getAttribute("position");
    this.bones.forEach((bone, number) => {
      const anchors = bone.map((place) => this.points[place].anchor);
      // A bone with an unknown end has no length.
      const isHere = anchors.every(({ x }) => !Number.isNaN(x));
      anchors.forEach(({ x, y, z }, end) => ends.setXYZ(2 * number + end, ...(isHere ? [x, y, z] : [0, 0, 0])));
    });
    ends.needsUpdate = true;
    this.stage.invalidate();
  }

  close() {
    this.stage.scene.remove(this.balls);
    this.balls.geometry.dispose();
    this.balls.material.dispose();
    this.balls.dispose();
    this.stage.scene.remove(this.lines);
    this.lines.geometry.dispose();
    this.lines.material.dispose();
  }
}
