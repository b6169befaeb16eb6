// Human bodies in 3D: everybody's skin in one draw call, bent by the graphics card.

import * as THREE from "../../vendor/three/three.module.js";
import { integers } from "../motion/base64.js";
import { BodyPose, TRANSFORM_VALUES } from "../motion/orientations.js";

/** Skins of all people of a description with a body. */
export class HumanBodies {
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
    this.mesh = new THREE.SkinnedMesh(skinOf(body, people, numJoints), new THREE.MeshLambertMaterial({ vertexColors: true }));
    this.mesh.bind(new Transforms(people.length * numJoints), new THREE.Matrix4());
    // Bounds of what moves would have to be computed for each frame.
    this.mesh.frustumCulled = false;
    this.mesh.boundingSphere = new THREE.Sphere();
    stage.scene.add(this.mesh);
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
function skinOf(body, people, numJoints) {
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
