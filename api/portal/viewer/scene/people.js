// People in 3D: bodies of humans, capsules or characters, skeletons of lines, trails, contacts of feet and arrows of their forces. One draw call for each.

import * as THREE from "../../vendor/three/three.module.js";
import { extrapolated, massCentre, positionsAt, standing } from "../motion/kinematics.js";
import { BodyPose, TRANSFORM_VALUES } from "../motion/orientations.js";
import { integers } from "../motion/records.js";

const TRAIL_S = 1.5;
const TRAIL_STEPS = 45;
const TRAILED = ["Hips", "LeftHand", "RightHand", "LeftFoot", "RightFoot"];
const FEET = [["LeftFoot", 0], ["RightFoot", 1]];
const CONTACT_RADIUS_M = 0.13;
const MASS_RADII_M = [0.045, 0.03]; // of the ball in the centre of mass, and of the flat one on the floor below the extrapolated centre
// Radius of the capsule that ends at a joint, in metres, by the end of the joint's name; fingers are thin.
const RADII = [
  [/Hand(Thumb|Index|Middle|Ring|Pinky)/, 0.009], [/HeadEnd$/, 0.085], [/Head$/, 0.05], [/(Spine|Chest)$/, 0.1],
  [/Neck$/, 0.07], [/Shoulder$/, 0.045], [/ForeArm$/, 0.045], [/Arm$/, 0.05], [/HandEnd$/, 0.028], [/Hand$/, 0.034],
  [/UpLeg$/, 0.075], [/Leg$/, 0.068], [/FootEnd$/, 0.036], [/Foot$/, 0.05],
];
const [ARROW_RADIUS_M, ARROW_COLOR] = [0.04, "#ffd75e"];
const HIDDEN = new THREE.Matrix4().makeScale(0, 0, 0);

export class PeopleFigures {
  #store;
  #people;
  #bones;
  #positions;
  #marks; // positions of the detector's joints
  #next; // room for positions of the frame after a place
  #ends = new Float32Array(3 * 2 * FEET.length); // tail and tip of each foot's force
  #meshes;
  #matrix = new THREE.Matrix4();
  #direction = new THREE.Vector3();
  #turn = new THREE.Quaternion();
  #from = new THREE.Vector3();
  #to = new THREE.Vector3();
  #scale = new THREE.Vector3();

  /** `characters` are the `CharacterFigures` of the stage. */
  constructor(stage, store, characters) {
    const { skeleton, people, body, joint_names: marks } = store.description;
    Object.assign(this, { stage, characters });
    this.#store = store;
    this.#people = people.map((person) => ({ ...person, tint: new THREE.Color(person.color), isShown: true }));
    this.#bones = skeleton.parents
      .map((parent, joint) => ({ parent, joint, radius: RADII.find(([name]) => name.test(skeleton.names[joint]))?.[1] ?? 0.04 }))
      // Collar bones start inside the chest: their capsules would stick out of the neck.
      .filter(({ parent, joint }) => parent !== null && !/^(Left|Right)Shoulder$/.test(skeleton.names[joint]));
    this.#positions = new Float32Array(3 * skeleton.names.length);
    this.#marks = new Float32Array(3 * marks.length);
    this.#next = { skeleton: this.#positions.slice(), joints: this.#marks.slice() };
    // Capsules are shown where the description has no human bodies.
    this.humans = body && people.length > 0 ? new HumanBodies(stage, store.description) : null;
    this.joints = Object.fromEntries(skeleton.names.map((name, number) => [name, number]));
    // Where the people are: names are shown there.
    this.anchors = people.map(() => new THREE.Vector3(NaN, NaN, NaN));
    this.ankles = ["left_ankle", "right_ankle"].map((name) => marks.indexOf(name));
    this.options = { body: true, shape: "human", skeleton: false, trails: true, contacts: true, forces: true, mass: false };
    this.#build();
  }

  setShown(person, isShown) {
    this.#people[person].isShown = isShown;
  }

  /** Put all people where they are at a place, a frame or between two frames. */
  show(place) {
    const frame = Math.round(place);
    const { body, shape, skeleton, contacts, forces, mass } = this.options;
    const hasForces = forces && this.#store.description.record?.offsets.forces !== undefined;
    const isHuman = shape === "human" && this.humans !== null;
    const isCapsule = shape === "capsule" || (shape === "human" && !isHuman);
    let segment = 0;
    this.characters.hide();
    this.#people.forEach((person, number) => {
      const isHere = person.isShown && this.#place(number, place, "skeleton", this.#positions);
      this.#anchor(number, isHere);
      this.#showCapsules(number, isHere && body && isCapsule);
      this.#showHuman(number, isHere && body && isHuman, place);
      if (isHere && body && shape === "character") this.#showCharacter(number, place);
      if (isHere && skeleton) segment = this.#addLines(segment, person.tint);
      this.#showContacts(number, person, isHere && contacts, frame);
      this.#showForces(number, isHere && hasForces, frame);
      this.#showMass(number, person, isHere && mass, frame);
    });
    this.lines.geometry.setDrawRange(0, 2 * segment);
    for (const name of ["position", "color"]) this.lines.geometry.getAttribute(name).needsUpdate = true;
    for (const mesh of [this.capsules, this.discs, this.arrows, this.balls]) mesh.instanceMatrix.needsUpdate = true;
    this.capsules.visible = body && isCapsule;
    this.humans?.update(body && isHuman);
    // Over a character, for comparison: it may be thicker, or built otherwise, than the person.
    this.lines.material.depthTest = shape !== "character";
    this.#showTrails(frame);
    this.stage.invalidate();
  }

  /** Box around all people in a frame; empty if no person is there. */
  boxAt(frame) {
    const box = new THREE.Box3();
    this.#people.forEach((person, number) => {
      if (!person.isShown || !this.#place(number, frame, "skeleton", this.#positions)) return;
      for (let joint = 0; joint < this.#positions.length; joint += 3) {
        if (Number.isFinite(this.#positions[joint])) box.expandByPoint(this.#from.fromArray(this.#positions, joint));
      }
    });
    return box;
  }

  close() {
    this.humans?.close();
    for (const mesh of this.#meshes) {
      this.stage.scene.remove(mesh);
      mesh.geometry.dispose();
      mesh.material.dispose();
      mesh.dispose?.();
    }
  }

  #build() {
    const numPeople = Math.max(1, this.#people.length);
    const numBones = Math.max(1, this.#bones.length);
    this.capsules = new THREE.InstancedMesh(capsule(), new THREE.MeshLambertMaterial(), numPeople * numBones);
    const disc = new THREE.MeshBasicMaterial({ transparent: true, opacity: 0.75, depthWrite: false });
    this.discs = new THREE.InstancedMesh(new THREE.RingGeometry(0.55, 1, 20), disc, numPeople * FEET.length);
    const tint = { color: ARROW_COLOR, depthTest: false };
    this.arrows = new THREE.InstancedMesh(arrow(), new THREE.MeshBasicMaterial(tint), numPeople * FEET.length);
    this.arrows.renderOrder = 2; // over the legs around them
    // Without people nothing of them is drawn: an instance that was never placed is a ball around the origin.
    this.balls = new THREE.InstancedMesh(new THREE.SphereGeometry(1, 12, 8), new THREE.MeshBasicMaterial({ depthTest: false }), numPeople * MASS_RADII_M.length);
    this.balls.renderOrder = 2; // over the body around the centre
    [this.capsules.count, this.discs.count, this.arrows.count, this.balls.count] = [numBones, FEET.length, FEET.length, MASS_RADII_M.length].map((number) => this.#people.length * number);
    this.#people.forEach(({ tint }, number) => {
      for (let bone = 0; bone < numBones; bone++) this.capsules.setColorAt(number * numBones + bone, tint);
      for (let foot = 0; foot < FEET.length; foot++) this.discs.setColorAt(number * FEET.length + foot, tint);
      MASS_RADII_M.forEach((_, ball) => this.balls.setColorAt(number * MASS_RADII_M.length + ball, tint));
    });
    this.lines = colouredLines(numPeople * numBones);
    this.lines.renderOrder = 1;
    this.trails = colouredLines(numPeople * TRAILED.length * TRAIL_STEPS);
    this.#meshes = [this.capsules, this.discs, this.arrows, this.balls, this.lines, this.trails];
    for (const mesh of this.#meshes) {
      mesh.frustumCulled = false; // bounds of what moves would have to be computed for each frame
      this.stage.add(mesh);
    }
  }

  #place(person, place, field, out) {
    return positionsAt(this.#store, person, place, field, out, this.#next[field]);
  }

  #anchor(number, isHere) {
    const anchor = this.anchors[number];
    anchor.set(NaN, NaN, NaN);
    if (!isHere) return;
    const top = [this.joints.HeadEnd, this.joints.Head, this.joints.Hips].find((joint) => Number.isFinite(this.#positions[3 * joint]));
    if (top !== undefined) anchor.fromArray(this.#positions, 3 * top).z += 0.18;
  }

  #showHuman(number, isShown, place) {
    if (isShown && this.#place(number, place, "joints", this.#marks)) this.humans.show(number, this.#positions, this.#marks);
    else this.humans?.hide(number);
  }

  #showCharacter(number, place) {
    const frame = Math.floor(place);
    const filed = this.#store.filed(number, frame);
    if (filed !== null) this.characters.show(filed.id, (filed.frame + place - frame) / this.#store.description.frame_rate_hz);
  }

  #showCapsules(number, isShown) {
    const numBones = this.#bones.length;
    this.#bones.forEach(({ parent, joint, radius }, bone) => {
      const place = number * numBones + bone;
      const length = this.#stretch(this.#positions, parent, joint);
      if (!isShown || !(length > 1e-4)) {
        this.capsules.setMatrixAt(place, HIDDEN);
        return;
      }
      this.#from.add(this.#to).multiplyScalar(0.5);
      // The round ends begin at the joints, so that capsules of neighbouring bones overlap there.
      this.#scale.set(radius, length + 1.2 * radius, radius);
      this.capsules.setMatrixAt(place, this.#matrix.compose(this.#from, this.#turn, this.#scale));
    });
  }

  /** Turn from upright to the way from one position to another, which become `#from` and `#to`; returns its length. */
  #stretch(positions, from, to) {
    this.#from.fromArray(positions, 3 * from);
    this.#to.fromArray(positions, 3 * to);
    this.#direction.subVectors(this.#to, this.#from);
    const length = this.#direction.length();
    this.#turn.setFromUnitVectors(THREE.Object3D.DEFAULT_UP, this.#direction.divideScalar(length));
    return length;
  }

  /** Add the bones to the lines from a segment on; returns the segment after them. */
  #addLines(segment, tint) {
    const points = this.lines.geometry.getAttribute("position");
    const colors = this.lines.geometry.getAttribute("color");
    for (const { parent, joint } of this.#bones) {
      if (!Number.isFinite(this.#positions[3 * parent]) || !Number.isFinite(this.#positions[3 * joint])) continue;
      for (const [end, place] of [[0, parent], [1, joint]]) {
        points.setXYZ(2 * segment + end, this.#positions[3 * place], this.#positions[3 * place + 1], this.#positions[3 * place + 2]);
        colors.setXYZ(2 * segment + end, tint.r, tint.g, tint.b);
      }
      segment += 1;
    }
    return segment;
  }

  #showContacts(number, { contacts }, isShown, frame) {
    FEET.forEach(([name, side], foot) => {
      const joint = 3 * this.joints[name];
      const place = number * FEET.length + foot;
      if (!isShown || !Number.isFinite(this.#positions[joint]) || !standing(contacts, side, frame)) {
        this.discs.setMatrixAt(place, HIDDEN);
        return;
      }
      const [x, y] = [this.#positions[joint], this.#positions[joint + 1]];
      this.#from.set(x, y, this.stage.floorZ(x, y) + 0.006);
      this.#scale.setScalar(CONTACT_RADIUS_M);
      this.discs.setMatrixAt(place, this.#matrix.compose(this.#from, this.#turn.identity(), this.#scale));
    });
  }

  /** Force of the ground on each foot, from the centre of pressure; none without contact. */
  #showForces(number, isShown, frame) {
    const isKnown = isShown && this.#store.positions(number, frame, "forces", this.#ends);
    FEET.forEach((_, foot) => {
      const length = isKnown ? this.#stretch(this.#ends, 2 * foot, 2 * foot + 1) : NaN;
      const matrix = length > 0 ? this.#matrix.compose(this.#from, this.#turn, this.#scale.set(ARROW_RADIUS_M, length, ARROW_RADIUS_M)) : HIDDEN;
      this.arrows.setMatrixAt(number * FEET.length + foot, matrix);
    });
  }

  /** Centre of mass, and the extrapolated one on the floor; each is hidden where a joint or the velocity is unknown. */
  #showMass(number, { mass_weights: weights }, isShown, frame) {
    const centreAt = (at) => (this.#place(number, at, "joints", this.#marks) ? massCentre(weights, this.#marks) : [NaN, NaN, NaN]);
    const places = MASS_RADII_M.map(() => [NaN, NaN, NaN]);
    if (isShown && weights) {
      places[0] = centreAt(frame);
      const ankles = [0, 1, 2].map((axis) => this.ankles.reduce((sum, joint) => sum + this.#marks[3 * joint + axis] / 2, 0));
      const [x, y] = extrapolated(centreAt, frame, ankles, this.#store.description.frame_rate_hz);
      places[1] = [x, y, this.stage.floorZ(x, y)];
    }
    places.forEach((place, ball) => {
      const isKnown = place.every(Number.isFinite);
      this.#scale.setScalar(MASS_RADII_M[ball]);
      if (ball === 1) this.#scale.z = 0.004;
      const matrix = isKnown ? this.#matrix.compose(this.#from.fromArray(place), this.#turn.identity(), this.#scale) : HIDDEN;
      this.balls.setMatrixAt(number * MASS_RADII_M.length + ball, matrix);
    });
  }

  /** Paths of hips, hands and feet over the last moments, fading out. */
  #showTrails(frame) {
    const { frame_rate_hz } = this.#store.description;
    const stride = Math.max(1, Math.round((TRAIL_S * frame_rate_hz) / TRAIL_STEPS));
    const points = this.trails.geometry.getAttribute("position");
    const colors = this.trails.geometry.getAttribute("color");
    const { background } = this.stage;
    let vertex = 0;
    const numSteps = this.options.trails ? Math.min(TRAIL_STEPS, Math.round((TRAIL_S * frame_rate_hz) / stride)) : 0;
    const before = new Float32Array(this.#positions.length);
    const after = new Float32Array(this.#positions.length);
    this.#people.forEach(({ isShown, tint }, number) => {
      if (!isShown || numSteps === 0 || !this.#store.positions(number, frame, "skeleton", after)) return;
      for (let step = 1; step <= numSteps; step++) {
        if (!this.#store.positions(number, frame - step * stride, "skeleton", before)) break;
        const fresh = [1 - (step - 1) / numSteps, 1 - step / numSteps];
        for (const name of TRAILED) {
          const joint = 3 * this.joints[name];
          if (!Number.isFinite(before[joint] + after[joint])) continue;
          [after, before].forEach((positions, end) => {
            points.setXYZ(vertex, positions[joint], positions[joint + 1], positions[joint + 2]);
            // Lines fade into the background: transparent ones would have to be sorted.
            const mix = (of) => background[of] + (tint[of] - background[of]) * fresh[end] * 0.85;
            colors.setXYZ(vertex, mix("r"), mix("g"), mix("b"));
            vertex += 1;
          });
        }
        after.set(before);
      }
    });
    this.trails.geometry.setDrawRange(0, vertex);
    points.needsUpdate = colors.needsUpdate = true;
  }
}

/** Upright capsule of height and radius 1 with few corners: drawing in software takes its time by these. */
function capsule() {
  const outline = [[0, -0.5], [0.62, -0.47], [1, -0.38], [1, 0.38], [0.62, 0.47], [0, 0.5]];
  return new THREE.LatheGeometry(outline.map(([radius, height]) => new THREE.Vector2(radius, height)), 8);
}

/** Upright arrow of height and radius 1, from the origin on. */
function arrow() {
  return new THREE.LatheGeometry([[0, 0], [0.4, 0], [0.4, 0.85], [1, 0.85], [0, 1]].map(([radius, height]) => new THREE.Vector2(radius, height)), 8);
}

function colouredLines(numSegments) {
  const geometry = new THREE.BufferGeometry();
  for (const name of ["position", "color"]) {
    const attribute = new THREE.BufferAttribute(new Float32Array(6 * Math.max(1, numSegments)), 3);
    geometry.setAttribute(name, attribute.setUsage(THREE.DynamicDrawUsage));
  }
  return new THREE.LineSegments(geometry, new THREE.LineBasicMaterial({ vertexColors: true }));
}

// Human bodies in 3D: everybody's skin in one draw call, bent by the graphics card.

/** Skins of all people of a description with a body. */
class HumanBodies {
  #pose;
  #rest; // of each person, positions of the body's joints
  #values; // of a person, transforms of the joints

  constructor(stage, description) {
    const { body, people } = description;
    this.stage = stage;
    this.#pose = new BodyPose(description);
    const { numJoints } = this.#pose;
    this.#rest = people.map((person) => Float32Array.from(integers(person.body.joints), (steps) => steps * body.step_m));
    this.#values = numJoints * TRANSFORM_VALUES;
    this.mesh = new THREE.SkinnedMesh(buildSkin(body, people, numJoints), new THREE.MeshLambertMaterial({ vertexColors: true }));
    this.mesh.bind(new Transforms(people.length * numJoints), new THREE.Matrix4());
    // Bounds of what moves would have to be computed for each frame.
    this.mesh.frustumCulled = false;
    this.mesh.boundingSphere = new THREE.Sphere();
    stage.add(this.mesh);
  }

  /** Bend a person's body to positions of the skeleton's joints and of the detector's. */
  show(person, positions, marks) {
    this.#pose.write(this.#rest[person], positions, marks, this.#matrices, person * this.#values);
  }

  /** Shrink a person's body to a point. */
  hide(person) {
    this.#matrices.fill(0, person * this.#values, (person + 1) * this.#values);
  }

  /** Draw what `show` and `hide` wrote, or nothing. */
  update(isVisible) {
    this.mesh.visible = isVisible;
    this.mesh.skeleton.boneTexture.needsUpdate = true;
  }

  close() {
    this.stage.scene.remove(this.mesh);
    this.mesh.geometry.dispose();
    this.mesh.material.dispose();
    this.mesh.skeleton.dispose();
  }

  get #matrices() {
    return this.mesh.skeleton.boneMatrices;
  }
}

/** Transforms of joints in a texture, which are written directly, not computed from a tree of bones. */
class Transforms extends THREE.Skeleton {
  constructor(count) {
    super(new Array(count).fill(null));
    this.computeBoneTexture();
  }

  update() {}
}

/** Skin of all people, vertex by vertex, with the numbers of the joints that move them. */
function buildSkin(body, people, numJoints) {
  const [triangles, carriers, weights] = [integers(body.triangles, Uint16Array), integers(body.carriers, Uint8Array), integers(body.weights, Uint8Array)];
  const numVertices = carriers.length / 4;
  const total = people.length * numVertices;
  const arrays = { position: new Float32Array(3 * total), color: new Float32Array(3 * total) };
  const [indices, joints, shares] = [new Uint32Array(people.length * triangles.length), new Uint16Array(4 * total), new Uint8Array(4 * total)];
  const tint = new THREE.Color();
  people.forEach(({ body: { vertices }, color }, number) => {
    const first = number * numVertices;
    arrays.position.set(Float32Array.from(integers(vertices), (steps) => steps * body.step_m), 3 * first);
    tint.set(color);
    for (let vertex = first; vertex < first + numVertices; vertex++) tint.toArray(arrays.color, 3 * vertex);
    for (let place = 0; place < triangles.length; place++) indices[number * triangles.length + place] = triangles[place] + first;
    for (let place = 0; place < carriers.length; place++) joints[4 * first + place] = carriers[place] + number * numJoints;
    shares.set(weights, 4 * first);
  });
  const geometry = new THREE.BufferGeometry();
  for (const [name, values] of Object.entries(arrays)) geometry.setAttribute(name, new THREE.BufferAttribute(values, 3));
  geometry.setAttribute("skinIndex", new THREE.BufferAttribute(joints, 4));
  geometry.setAttribute("skinWeight", new THREE.BufferAttribute(shares, 4, true));
  geometry.setIndex(new THREE.BufferAttribute(indices, 1));
  geometry.computeVertexNormals();
  return geometry;
}
