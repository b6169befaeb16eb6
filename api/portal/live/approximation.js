// Positions of the skeleton's joints from those of a detector, for people whose bones are not learnt yet.

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

/** Function that writes positions of `bones` from those of `joints`, both lists of names; NaN where one is unknown. */
export function approximationOf(bones, joints) {
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
