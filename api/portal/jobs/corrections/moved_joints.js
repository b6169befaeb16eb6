// Preview of corrections: keyed joints move with the limbs that they carry, and sides are exchanged, before a fit has run.

// Time before the first and after the last key of a joint in which it goes to its place and back, as in the fit.
const REACH_S = 0.5;
const PARENTS = { elbow: "shoulder", wrist: "elbow", knee: "hip", ankle: "knee", heel: "ankle", big_toe: "ankle", small_toe: "ankle" };
const BONES = { shoulder: "Arm", elbow: "ForeArm", wrist: "Hand", hip: "UpLeg", knee: "Leg", ankle: "Foot" };
const BENDS = { wrist: ["shoulder", "elbow"], ankle: ["hip", "knee"] };
/** Names of the joints of both sides that are exchanged. */
export const SIDES = { arms: /shoulder|elbow|wrist|thumb|index|middle|ring|pinky|Shoulder|Arm|Hand/, legs: /hip|knee|ankle|heel|toe|Leg|Foot/, all: /./ };

const parts = (joint) => /^(left|right)_(.+)$/.exec(joint)?.slice(1) ?? [null, joint];

function parentMark(name) {
  const [side, kind] = parts(name);
  const parent = PARENTS[kind] ?? (/thumb|index|middle|ring|pinky/.test(kind) ? "wrist" : null);
  return side && parent ? `${side}_${parent}` : null;
}

/** Name of the skeleton's joint at a joint of the detector; null if it has none. */
function boneOf(joint) {
  const [side, kind] = parts(joint);
  return side && BONES[kind] ? `${side === "left" ? "Left" : "Right"}${BONES[kind]}` : null;
}

/** Joints of a take, as the detector (`joints`) and the skeleton have them, with what each carries. */
export class JointTree {
  constructor({ joint_names: marks, skeleton }) {
    this.names = { joints: marks, skeleton: skeleton.names };
    this.parents = { joints: marks.map((name) => marks.indexOf(parentMark(name))), skeleton: skeleton.parents.map((parent) => parent ?? -1) };
  }

  /** Number of a detector's joint in a field; -1 if the field has none. */
  find(field, joint) {
    return this.names[field].indexOf(field === "joints" ? joint : boneOf(joint));
  }

  /** Move a joint, and the joints that it carries; of a limb's end, the limb bends with bones of the same length. */
  move(field, positions, joint, offset) {
    const moved = this.find(field, joint);
    if (moved < 0) return;
    const [side, kind] = parts(joint);
    const [root, middle] = (BENDS[kind] ?? []).map((name) => this.find(field, `${side}_${name}`));
    const lengths = root >= 0 ? [distance(positions, root, middle), distance(positions, middle, moved)] : null;
    this.parents[field].forEach((_, number) => {
      if (this.#isCarried(field, number, moved)) for (let axis = 0; axis < 3; axis++) positions[3 * number + axis] += offset[axis];
    });
    if (lengths) bend(positions, root, middle, moved, lengths);
  }

  /** Exchange left and right joints: of `arms`, `legs` or `all`. */
  exchange(field, positions, part) {
    this.names[field].forEach((name, left) => {
      const right = this.names[field].indexOf(name.replace(/^left_/, "right_").replace(/^Left/, "Right"));
      if (right < 0 || right === left || !SIDES[part].test(name)) return;
      for (let axis = 0; axis < 3; axis++) {
        [positions[3 * left + axis], positions[3 * right + axis]] = [positions[3 * right + axis], positions[3 * left + axis]];
      }
    });
  }

  #isCarried(field, number, by) {
    for (let joint = number; joint >= 0; joint = this.parents[field][joint]) if (joint === by) return true;
    return false;
  }
}

const distance = (positions, one, other) => Math.hypot(...[0, 1, 2].map((axis) => positions[3 * one + axis] - positions[3 * other + axis]));

/** Put the middle joint of a limb between its ends, on the side on which it is, with both bones as long as before. */
function bend(positions, root, middle, end, [upper, lower]) {
  const at = (joint) => [0, 1, 2].map((axis) => positions[3 * joint + axis]);
  const [start, old, stop] = [at(root), at(middle), at(end)];
  const way = stop.map((value, axis) => value - start[axis]);
  const length = Math.hypot(...way);
  if (!(length > 1e-6)) return;
  const along = way.map((value) => value / length);
  const dot = old.reduce((sum, value, axis) => sum + (value - start[axis]) * along[axis], 0);
  const pole = old.map((value, axis) => value - start[axis] - dot * along[axis]);
  const height = Math.max(1e-9, Math.hypot(...pole));
  const reached = Math.min(length, upper + lower);
  const foot = (upper ** 2 - lower ** 2 + reached ** 2) / (2 * reached);
  const rise = Math.sqrt(Math.max(0, upper ** 2 - foot ** 2));
  for (let axis = 0; axis < 3; axis++) positions[3 * middle + axis] = start[axis] + foot * along[axis] + (rise * pole[axis]) / height;
}

/**
 * Corrections that a store shows before their files are there: its `preview`.
 *
 * `corrections` are edits of persons by their numbers in the store, in frames of the take, places in metres from the
 * take's origin.
 */
export class Preview {
  #store;
  #tree;
  #sides;
  #keys; // of each person and joint, from the first frame to the last one
  #joints;

  constructor(store, corrections) {
    this.#store = store;
    this.#tree = new JointTree(store.description);
    this.#sides = corrections.filter(({ action }) => action === "exchange_sides");
    // Of two keys of a joint in a frame the later counts.
    const keys = new Map(corrections.filter(({ action }) => action === "key").map((key) => [`${key.person} ${key.joint} ${key.frame}`, key]));
    this.#keys = Map.groupBy([...keys.values()].sort((one, other) => one.frame - other.frame), ({ person, joint }) => `${person} ${joint}`);
    this.#joints = new Float32Array(3 * store.description.joint_names.length);
  }

  /** Correct positions of a person at a place among the frames. */
  adjust(person, place, field, positions) {
    for (const { person: of, part, start_frame: start, stop_frame: stop } of this.#sides) {
      if (of === person && place > start - 0.5 && place < stop - 0.5) this.#tree.exchange(field, positions, part);
    }
    for (const keys of this.#keys.values()) {
      const [{ person: of, joint }] = keys;
      const offset = of === person ? this.#offsetAt(keys, place) : null;
      if (offset) this.#tree.move(field, positions, joint, offset);
    }
  }

  /** Offset of a keyed joint at a place: from key to key, and from and to nothing within the reach of keys. */
  #offsetAt(keys, place) {
    const reach = REACH_S * this.#store.description.frame_rate_hz;
    const rest = (one, other, frame) => (other?.frame - one?.frame < 2 * reach ? [] : [[frame, [0, 0, 0]]]);
    const knots = keys.flatMap((key, number) => [
      ...rest(keys[number - 1], key, key.frame - reach), [key.frame, this.#offset(key)], ...rest(key, keys[number + 1], key.frame + reach),
    ]);
    const after = knots.findIndex(([frame]) => frame >= place);
    if (after < 1 || !knots[after - 1][1] || !knots[after][1]) return null;
    const [[start, one], [stop, other]] = knots.slice(after - 1, after + 1);
    const share = (place - start) / Math.max(1e-9, stop - start);
    return one.map((value, axis) => value + share * share * (3 - 2 * share) * (other[axis] - value));
  }

  #offset({ person, joint, frame, place_m: placeM }) {
    const number = this.#tree.find("joints", joint);
    if (number < 0 || !this.#store.positions(person, frame, "joints", this.#joints)) return null;
    const offset = placeM.map((value, axis) => value - this.#joints[3 * number + axis]);
    return offset.every(Number.isFinite) ? offset : null;
  }
}
