// People of a live capture in 3D, with the scene of the viewer.

import { LIVE } from "../shared/strings/live.js";
import { directionBar } from "../viewer/controls.js";
import { el, graphics } from "../viewer/dom.js";
import { about, chooseOrigin } from "../viewer/motion/records.js";
import { SceneView } from "../viewer/scene/scene_view.js";

/**
 * 3D view of a live capture in an element.
 *
 * `ready` is the message `ready` of the service, `rateHz` the rate of the instants. `element.dataset.people` has the number of
 * people who are drawn.
 */
export class LiveScene {
  #store;
  #view = null;
  #isOpen = true;
  #isDrawn = true; // whether the latest instant is drawn
  #isNew = false; // whether people came or left since
  #isAimed = false; // whether the view was turned to the first people

  constructor(element, ready, rateHz) {
    this.element = element;
    this.#store = new LiveStore(ready, rateHz);
    if (!graphics().hasWebGL) {
      element.replaceChildren(el("p", { class: "look-no-3d" }, LIVE.no3d));
      return;
    }
    const { cameras } = this.#store.description;
    this.description = { cameras };
    const canvas = el("canvas", { class: "look-canvas", tabindex: 0, role: "img", "aria-label": `3D view of the people in view of ${cameras.length} cameras` });
    const layer = el("div", { class: "look-labels", "aria-hidden": "true" });
    this.bar = directionBar(this);
    element.replaceChildren(canvas, layer, el("div", { class: "look-overlay" }, this.bar.element));
    this.#view = new SceneView(canvas, layer, this.#store);
    this.#view.open(0);
    requestAnimationFrame((now) => this.#tick(now));
  }

  /** Show an instant, as `unpackInstant` gives it; of several between two pictures the last one is drawn. */
  show(instant) {
    this.#isNew = this.#store.add(instant) || this.#isNew;
    this.#isDrawn = false;
  }

  /** Look at everybody, from a named direction or as before. */
  fit(direction = null) {
    this.see(null);
    this.#view.fit(direction);
  }

  /** See through a camera, by its number; null: orbit again. */
  see(number) {
    this.#view.see(number);
    this.bar.showSeen(number);
  }

  close() {
    this.#isOpen = false;
    this.#view?.close();
  }

  #tick(now) {
    if (!this.#isOpen) return;
    if (!this.#isDrawn) this.#draw();
    this.#view.draw(now);
    requestAnimationFrame((next) => this.#tick(next));
  }

  #draw() {
    this.#isDrawn = true;
    if (this.#isNew) this.#view.replace(this.#store);
    this.#isNew = false;
    this.#view.show(this.#store.frame);
    const { people } = this.#store.description;
    this.element.dataset.people = people.length;
    if (this.#isAimed || people.length === 0) return;
    this.#isAimed = true;
    this.#view.fit();
  }
}

// People of the latest instants of a live capture, as the 3D view reads them.

// The 3D view draws trails of a second and a half.
const KEPT_S = 1.6;
const HUE_STEP = 0.618034; // as pipeline/export/scene.py

/** Colour of a person, the same as in results. */
export const personColor = (id) => `hsl(${((id * HUE_STEP) % 1) * 360}, 100%, 57.5%)`;

/**
 * Store of the latest instants. Frames are numbers of instants, from 0.
 *
 * `ready` is the message `ready` of the service, `rateHz` the rate of the instants. `description` has the people of the latest
 * instants; it is another object as soon as others are there.
 */
export class LiveStore {
  #kept; // positions of the skeleton's joints by person, of each of the latest instants
  #approximate;

  constructor({ joints, bones, parents, rig }, rateHz) {
    const places = new Map(bones.map((name, place) => [name, place]));
    const skeleton = { names: bones, parents: parents.map((name) => (name === null ? null : places.get(name))) };
    const bare = { frame_rate_hz: rateHz, joint_names: joints, skeleton, body: null, floor: null, cameras: rig, people: [] };
    this.description = about(bare, chooseOrigin(bare));
    this.frame = -1;
    this.#kept = new Array(Math.max(2, Math.ceil(KEPT_S * rateHz))).fill(null);
    this.#approximate = makeApproximation(bones, joints);
  }

  /** Take an instant; returns whether `description` is another one, as a person came or left. */
  add({ people }) {
    const numValues = 3 * this.description.skeleton.names.length;
    const positions = new Map(people.map(({ id, joints, skeleton }) => {
      const out = new Float32Array(numValues);
      if (skeleton) out.set(skeleton.joints);
      else this.#approximate(joints, out);
      return [id, this.#moved(out)];
    }));
    this.frame += 1;
    this.#kept[this.frame % this.#kept.length] = positions;
    const known = this.description.people.map(({ id }) => id);
    const seen = [...new Set(this.#kept.flatMap((instant) => (instant ? [...instant.keys()] : [])))].sort((one, other) => one - other);
    if (seen.length === known.length && seen.every((id, place) => id === known[place])) return false;
    this.description = { ...this.description, people: seen.map((id) => ({ id, name: LIVE.personName(id), color: personColor(id), contacts: [] })) };
    return true;
  }

  /** Positions of a person's joints in one of the latest instants; whether there are any. */
  positions(person, frame, field, out) {
    if (frame < 0 || frame > this.frame || frame <= this.frame - this.#kept.length) return false;
    const found = this.#kept[frame % this.#kept.length]?.get(this.description.people[person].id);
    if (!found) return false;
    out.set(found);
    return true;
  }

  #moved(positions) {
    const { origin_m: origin } = this.description;
    for (let place = 0; place < positions.length; place++) positions[place] -= origin[place % 3];
    return positions;
  }
}

// Positions of the skeleton's joints from a detector's joints, for people whose bones are not learnt yet.

const both = (part) => ({ [`left_${part}`]: 0.5, [`right_${part}`]: 0.5 });

/** Sum of weighted positions, by the names of their joints. */
function mixed(...parts) {
  const sum = {};
  for (const [share, weights] of parts) for (const [name, weight] of Object.entries(weights)) sum[name] = (sum[name] ?? 0) + share * weight;
  return sum;
}

const [HIPS, SHOULDERS, EARS] = ["hip", "shoulder", "ear"].map(both);
const LIMBS = { Arm: "shoulder", ForeArm: "elbow", Hand: "wrist", UpLeg: "hip", Leg: "knee", Foot: "ankle" };

// Weights of the detector's joints, by the joint of the skeleton; other joints of the skeleton stay unknown.
const WEIGHTS = {
  Hips: HIPS,
  Spine: mixed([0.7, HIPS], [0.3, SHOULDERS]),
  Chest: mixed([0.35, HIPS], [0.65, SHOULDERS]),
  Neck: SHOULDERS,
  Head: mixed([0.3, SHOULDERS], [0.7, EARS]),
  HeadEnd: mixed([-0.2, SHOULDERS], [1.2, EARS]),
  ...Object.fromEntries(["Left", "Right"].flatMap((side) => [
    [`${side}Shoulder`, SHOULDERS],
    ...Object.entries(LIMBS).map(([bone, part]) => [`${side}${bone}`, { [`${side.toLowerCase()}_${part}`]: 1 }]),
  ])),
};

/** Function that writes positions of `bones` from positions of `joints`, both lists of names; NaN where one is unknown. */
function makeApproximation(bones, joints) {
  const rows = bones.map((bone) => {
    const weights = Object.entries(WEIGHTS[bone] ?? {}).map(([name, weight]) => [joints.indexOf(name), weight]);
    return weights.length > 0 && weights.every(([joint]) => joint >= 0) ? weights : null;
  });
  return (located, out) => {
    rows.forEach((weights, bone) => {
      for (let axis = 0; axis < 3; axis++) {
        out[3 * bone + axis] = weights === null ? NaN : weights.reduce((sum, [joint, weight]) => sum + weight * located[3 * joint + axis], 0);
      }
    });
    return out;
  };
}
