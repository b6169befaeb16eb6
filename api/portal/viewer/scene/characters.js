// The people of a take as a character of the user's own: one mesh for all, a skeleton for each.

import { VIEWER } from "../../shared/strings/viewer.js";
import * as THREE from "../../vendor/three/three.module.js";
import { isCompressed, readCharacter, simplify } from "../motion/character.js";

// Files have Y up, the scene has Z up.
const WORLD_FROM_FILE = new THREE.Quaternion().setFromAxisAngle(new THREE.Vector3(1, 0, 0), Math.PI / 2);

/** Characters in the scene, in the metres of the people whose motion they have: feet are where the people's are. */
export class CharacterFigures {
  #stage;
  #origin;
  #model = null; // { scene, nodes }: the mesh, and the text of its nodes
  #figures = new Map(); // by the number of the person

  /** `origin` is the world position about which the take is drawn. */
  constructor(stage, origin) {
    this.#stage = stage;
    this.#origin = origin;
  }

  /**
   * Load the files of all people in place of those that were loaded before.
   *
   * The mesh is the same in all files, so it is read from the first alone. `onshare` is told the share of the bytes that
   * are here. The promise is rejected if a file can't be read or shown, or `signal` ends it; then nothing has changed.
   */
  async load(files, signal, onshare) {
    const motions = [];
    for (const file of files) motions.push(await readCharacter(file, signal));
    const [first, ...others] = motions;
    if (isCompressed(first.document)) throw new Error(VIEWER.characterCompressed);
    const nodes = JSON.stringify(first.document.nodes);
    const isNew = this.#model?.nodes !== nodes;
    const read = reader(isNew ? [[0, first.file.numBytes], ...others.map(({ range }) => range)] : motions.map(({ range }) => range), signal, onshare);
    const model = isNew ? { scene: await whole(first, read), nodes } : this.#model;
    try {
      for (const motion of isNew ? others : motions) motion.fill(await read(motion.file, motion.range));
      const { clone } = await import("../../vendor/three/addons/utils/SkeletonUtils.js");
      signal.throwIfAborted();
      this.#replace(model, motions.map((motion) => new ShownCharacter(clone(model.scene), motion, this.#origin)));
    } catch (error) {
      if (isNew) release(model.scene);
      throw error;
    }
  }

  /** Hide everybody, before those who are there are shown. */
  hide() {
    for (const { group } of this.#figures.values()) group.visible = false;
  }

  /** Show a person at a time since the first frame of the take, unless their file says that they are absent. */
  show(id, seconds) {
    const figure = this.#figures.get(id);
    const row = figure?.motion.rowAt(seconds) ?? null;
    if (row === null) return;
    figure.group.visible = true;
    figure.pose(row);
  }

  /** Remove everybody, and free the memory. */
  clear() {
    this.#replace(null, []);
  }

  #replace(model, figures) {
    for (const figure of this.#figures.values()) {
      this.#stage.scene.remove(figure.group);
      figure.close();
    }
    if (this.#model !== null && this.#model !== model) release(this.#model.scene);
    this.#model = model;
    this.#figures = new Map(figures.map((figure) => [figure.motion.file.id, figure]));
    for (const { group } of figures) this.#stage.add(group);
  }
}

class ShownCharacter {
  #channels;
  #next = new THREE.Vector3();
  #turn = new THREE.Quaternion();

  constructor(object, motion, origin) {
    Object.assign(this, { motion, group: new THREE.Group() });
    this.group.add(object);
    this.group.visible = false;
    this.group.quaternion.copy(WORLD_FROM_FILE);
    this.group.scale.setScalar(1 / motion.unitsPerM);
    this.group.position.fromArray(motion.originM.map((value, axis) => value - origin[axis]));
    const nodes = new Map();
    object.traverse((child) => {
      // Bounds of what moves would have to be computed for each frame.
      child.frustumCulled = false;
      if (child.userData.node !== undefined) nodes.set(child.userData.node, child);
    });
    this.#channels = motion.channels.filter(({ node }) => nodes.has(node)).map((channel) => ({ ...channel, object: nodes.get(channel.node) }));
  }

  /** Take the pose of a row of the keys, or one between two rows. */
  pose(row) {
    const before = Math.floor(row);
    const share = row - before;
    for (const { object, path, values } of this.#channels) {
      if (path === "rotation") {
        object.quaternion.fromArray(values, 4 * before);
        if (share > 0) object.quaternion.slerp(this.#turn.fromArray(values, 4 * (before + 1)), share);
      } else {
        object.position.fromArray(values, 3 * before);
        if (share > 0) object.position.lerp(this.#next.fromArray(values, 3 * (before + 1)), share);
      }
    }
  }

  close() {
    this.group.traverse(({ skeleton }) => skeleton?.dispose());
  }
}

/** Function that reads ranges of files, and tells the share of all `ranges` that was read. */
function reader(ranges, signal, onshare) {
  const total = ranges.reduce((sum, [from, to]) => sum + to - from, 0);
  let done = 0;
  const onbytes = (count) => { done += count; onshare(done / total); };
  return (file, [from, to]) => file.read(from, to, { signal, onbytes });
}

/** Mesh of a file, which is read whole with the keys of its motion. */
async function whole(motion, read) {
  const { GLTFLoader } = await import("../../vendor/three/addons/loaders/GLTFLoader.js");
  const bytes = await read(motion.file, [0, motion.file.numBytes]);
  // A copy: the bytes of the mesh are not kept for the keys' sake.
  motion.fill(bytes.slice(...motion.range));
  const loader = new GLTFLoader().register((parser) => {
    simplify(parser.json);
    // Pictures are shown as images: the page's Content-Security-Policy lets no request fetch them.
    parser.textureLoader = new THREE.TextureLoader(parser.options.manager);
    return { name: "simplified" };
  });
  const { scene } = await loader.parseAsync(bytes, "").catch((error) => { throw new Error(`${motion.file.name} can't be drawn (${error.message}).`); });
  const known = new Map();
  scene.traverse((object) => {
    if (!object.material) return;
    if (!known.has(object.material)) known.set(object.material, matt(object.material));
    object.material = known.get(object.material);
  });
  return scene;
}

/** Material under the light of the other bodies: there is nothing here that metal could reflect. */
function matt(material) {
  if (!material.isMeshStandardMaterial) return material;
  const { name, color, map, emissive, emissiveMap, opacity, transparent, alphaTest, depthWrite, side, vertexColors, flatShading } = material;
  material.dispose();
  return new THREE.MeshLambertMaterial({ name, color, map, emissive, emissiveMap, opacity, transparent, alphaTest, depthWrite, side, vertexColors, flatShading });
}

function release(scene) {
  scene.traverse(({ geometry, material, skeleton }) => {
    geometry?.dispose();
    skeleton?.dispose();
    for (const name of ["map", "emissiveMap"]) material?.[name]?.dispose();
    material?.dispose();
  });
}
