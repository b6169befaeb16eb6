// People of the latest instants of a live capture, as the 3D view reads them.

import { about, originOf } from "../viewer/motion/nearby.js";
import { approximationOf } from "./approximation.js";

// The 3D view draws trails of a second and a half.
const KEPT_S = 1.6;
const HUE_STEP = 0.618034; // as pipeline/export/colors.py

/** Colour of a person, the same as in results. */
export const colorOf = (id) => `hsl(${((id * HUE_STEP) % 1) * 360}, 100%, 57.5%)`;

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
    this.description = about(bare, originOf(bare));
    this.frame = -1;
    this.#kept = new Array(Math.max(2, Math.ceil(KEPT_S * rateHz))).fill(null);
    this.#approximate = approximationOf(bones, joints);
  }

  /** Take an instant; returns whether `description` is another one, as somebody came or left. */
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
    this.description = { ...this.description, people: seen.map((id) => ({ id, name: `Person ${id}`, color: colorOf(id), contacts: [] })) };
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
