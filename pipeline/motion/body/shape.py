"""A body shaped by a person's bones.

The age of the shape follows from the person's stature: children have children's proportions. In the rest pose the bones
lie along the axes of the world, so that each joint stretches what it moves along these axes: along the bone by the
ratio of the person's length to the shape's, across by the ratio of the statures. Between joints the stretching passes
smoothly, by the weights of the skin.
"""

from dataclasses import dataclass
from math import radians

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import Floor, SkeletonMotion
from pipeline.motion.body.joints import BODY_INDEX, BODY_JOINTS, TWIST_JOINTS, about, blend, placed, world_from_joints
from pipeline.motion.skeleton.model import INDEX, SKELETON, WHOLE_SKELETON, joint_pose, parent_indices, rest_offsets_m

# Stature from which on people have the shape of adults. It is less than the adult shape's: small adults are not
# children.
_ADULT_STATURE_M = 1.5
# Axes along which a joint stretches by the ratio of a bone: the axis, and the joint at the bone's end. Fingers and feet
# are stretched alike along all axes.
_ALONG = {
    "Hips": ((0, "LeftUpLeg"), (2, "Spine")),
    "Spine": ((2, "Chest"),),
    "Chest": ((0, "LeftArm"), (2, "Neck")),
    "Shoulder": ((0, "Arm"),),
    "Neck": ((2, "Head"),),
    "Head": ((2, "HeadEnd"),),
    "Arm": ((0, "ForeArm"),),
    "ForeArm": ((0, "Hand"),),
    "UpLeg": ((2, "Leg"),),
    "Leg": ((2, "Foot"),),
}
_WHOLE = {"Hand": "HandEnd", "Foot": "FootEnd"}
# Turn by which the joints of fingers without a motion are bent, downwards in the rest pose; of the thumb half as much.
_RELAXED_RAD = radians(14.0)


@dataclass(frozen=True, slots=True, eq=False)
class BodyShapes:
    """Shapes of a body in the rest pose by age, in metres and world axes, standing at the origin."""

    # The last age is the adult's
    vertices_m: Float[np.ndarray, "ages vertices 3"]
    joints_m: Float[np.ndarray, "ages joints 3"]
    triangles: Int[np.ndarray, "triangles 3"]  # Indices of vertices, counterclockwise from outside
    # Positions in ``BODY_JOINTS`` of the joints that move each vertex, and their weights, of sum 1
    carriers: Int[np.ndarray, "vertices 4"]
    weights: Float[np.ndarray, "vertices 4"]
    coarse_triangles: Int[np.ndarray, "coarse_triangles 3"]  # Triangles between some of the vertices

    def coarse(self) -> "BodyShapes":
        """Shapes of the coarse mesh: its triangles, and the vertices that these have."""
        kept, corners = np.unique(self.coarse_triangles, return_inverse=True)
        triangles = corners.reshape(-1, 3)
        return BodyShapes(
            self.vertices_m[:, kept], self.joints_m, triangles, self.carriers[kept], self.weights[kept], triangles
        )


@dataclass(frozen=True, slots=True, eq=False)
class ShapedBody:
    """Body of a person in the rest pose, in metres and world axes, standing at the origin."""

    vertices_m: Float[np.ndarray, "vertices 3"]
    triangles: Int[np.ndarray, "triangles 3"]
    # Positions of the skeleton's joints, then of the twist joints
    joints_m: Float[np.ndarray, "joints 3"]
    # Positions in ``joints_m`` of the joints that move each vertex, and their weights, of sum 1
    carriers: Int[np.ndarray, "vertices 4"]
    weights: Float[np.ndarray, "vertices 4"]


def shape_body(
    shapes: BodyShapes, bone_length_m: Float[np.ndarray, " joints"], ankle_m: float | None = None
) -> ShapedBody:
    """Shape a body by the lengths of a skeleton's bones, with or without fingers.

    Without fingers, the hand's have the proportions of the average and are a little bent. ``ankle_m`` is the height of
    the ankles above the floor while the person stands, ``None``: the skeleton's at rest. The soles stand on the
    floor.
    """
    num_joints = len(bone_length_m)
    vertices_m, rest_m = _aged(shapes, _stature_m(bone_length_m))
    joints_m = _joint_positions_m(_with_fingers(bone_length_m))
    scales = _scales(rest_m, joints_m)
    feet = [INDEX["LeftFoot"], INDEX["RightFoot"]]
    if ankle_m is not None:
        scales[feet, 2] = ankle_m / rest_m[feet, 2]
        joints_m[:, 2] += ankle_m - joints_m[feet[0], 2]
    stretched = about(scales[:, :, None] * np.eye(3), rest_m, joints_m)
    vertices_m = blend(vertices_m, shapes.carriers, shapes.weights, stretched)
    carriers = shapes.carriers
    if num_joints == len(SKELETON):
        vertices_m = _relax_fingers(vertices_m, joints_m, shapes)
        joints_m = joints_m[[*range(num_joints), *(BODY_INDEX[twist.name] for twist in TWIST_JOINTS)]]
        carriers = _WITHOUT_FINGERS[carriers]
    return ShapedBody(vertices_m, shapes.triangles, joints_m, carriers, shapes.weights)


def _carriers_without_fingers() -> Int[np.ndarray, " joints"]:
    """Position among a skeleton's joints without fingers, and its twist joints, by position in ``BODY_JOINTS``."""
    hands = {
        name: INDEX[f"{side}Hand"] for side in ("Left", "Right") for name in INDEX if name.startswith(f"{side}Hand")
    }
    first = len(SKELETON) - len(WHOLE_SKELETON)
    return np.array(
        [
            number if number < len(SKELETON) else hands.get(name, number + first)
            for number, name in enumerate(BODY_JOINTS)
        ]
    )


_WITHOUT_FINGERS = _carriers_without_fingers()


def _stature_m(bone_length_m: Float[np.ndarray, " joints"]) -> float:
    """Height of the head's end above the ends of the feet in the rest pose."""
    joints_m = _joint_positions_m(bone_length_m)
    return float(joints_m[INDEX["HeadEnd"], 2])


def _joint_positions_m(bone_length_m: Float[np.ndarray, " joints"]) -> Float[np.ndarray, "all_joints 3"]:
    """Positions of the skeleton's joints, then of its twist joints, in the rest pose on the floor."""
    offsets_m = rest_offsets_m(bone_length_m)
    places_m = np.zeros((len(offsets_m) + len(TWIST_JOINTS), 3))
    for joint, parent in enumerate(parent_indices(len(offsets_m))[1:], 1):
        places_m[joint] = places_m[parent] + offsets_m[joint]
    for number, twist in enumerate(TWIST_JOINTS, len(offsets_m)):
        elbow_m, wrist_m = places_m[INDEX[twist.parent]], places_m[INDEX[twist.hand]]
        places_m[number] = elbow_m + twist.share * (wrist_m - elbow_m)
    return places_m - [0.0, 0.0, places_m[:, 2].min()]


def _with_fingers(bone_length_m: Float[np.ndarray, " joints"]) -> Float[np.ndarray, " whole_joints"]:
    """Lengths of the bones of the skeleton with fingers; those that are not given are in proportion to the hand."""
    lengths_m = np.array([joint.stature_share for joint in WHOLE_SKELETON])
    lengths_m[: len(bone_length_m)] = bone_length_m
    for joint in WHOLE_SKELETON[len(bone_length_m) :]:
        end = INDEX[f"{'Left' if joint.name.startswith('Left') else 'Right'}HandEnd"]
        lengths_m[INDEX[joint.name]] *= bone_length_m[end] / WHOLE_SKELETON[end].stature_share
    return lengths_m


def _aged(
    shapes: BodyShapes, stature_m: float
) -> tuple[Float[np.ndarray, "vertices 3"], Float[np.ndarray, "joints 3"]]:
    statures_m = shapes.joints_m[:, BODY_INDEX["HeadEnd"], 2].copy()
    statures_m[-1] = _ADULT_STATURE_M
    age = float(np.interp(stature_m, statures_m, np.arange(len(statures_m))))
    younger = min(int(age), len(statures_m) - 2)
    share = age - younger
    vertices_m, joints_m = (
        (1.0 - share) * values[younger] + share * values[younger + 1] for values in (shapes.vertices_m, shapes.joints_m)
    )
    return vertices_m, joints_m


def _scales(
    rest_m: Float[np.ndarray, "joints 3"], joints_m: Float[np.ndarray, "joints 3"]
) -> Float[np.ndarray, "joints 3"]:
    """Factors by which each joint stretches what it moves, along the axes of the world."""

    def ratio(start: str, end: str) -> float:
        ends = [BODY_INDEX[end], BODY_INDEX[start]]
        return float(np.linalg.norm(np.subtract(*joints_m[ends])) / np.linalg.norm(np.subtract(*rest_m[ends])))

    top = BODY_INDEX["HeadEnd"]
    scales = np.full((len(BODY_JOINTS), 3), joints_m[top, 2] / rest_m[top, 2])
    for number, joint in enumerate(WHOLE_SKELETON):
        side = joint.name.removesuffix(joint.kind)
        for axis, end in _ALONG.get(joint.kind, ()):
            # Both sides of the trunk have the mean of their ratios.
            sides = ("Left", "Right") if end.startswith("Left") else (side,)
            ends = [f"{each}{end.removeprefix('Left')}" for each in sides]
            starts = [f"{each}Shoulder" if end == "LeftArm" else joint.name for each in sides]
            scales[number, axis] = np.mean([ratio(*pair) for pair in zip(starts, ends, strict=True)])
        if joint.kind in _WHOLE:
            scales[number] = ratio(joint.name, f"{side}{_WHOLE[joint.kind]}")
        elif joint.name.startswith(("LeftHand", "RightHand")) and not joint.name.endswith("End"):
            last = joint.name[-1]
            scales[number] = ratio(joint.name, f"{joint.name[:-1]}{'3End' if last == '3' else int(last) + 1}")
    for twist in TWIST_JOINTS:
        scales[BODY_INDEX[twist.name]] = scales[BODY_INDEX[twist.parent]]
    return scales


def _relax_fingers(
    vertices_m: Float[np.ndarray, "vertices 3"], joints_m: Float[np.ndarray, "joints 3"], shapes: BodyShapes
) -> Float[np.ndarray, "vertices 3"]:
    """Bend the fingers of a body at rest a little."""
    turns = np.zeros((len(WHOLE_SKELETON), 3))
    for number, joint in enumerate(WHOLE_SKELETON[len(SKELETON) :], len(SKELETON)):
        downwards = 1.0 if joint.name.startswith("Left") else -1.0
        turns[number, 1] = downwards * _RELAXED_RAD * (0.5 if "Thumb" in joint.name else 1.0)
    world = world_from_joints(Rotation.from_rotvec(turns).as_quat())
    return blend(vertices_m, shapes.carriers, shapes.weights, about(world, joints_m, placed(world, joints_m)))


# Heights as multiples of the skeleton's at rest: who stands lower or higher stands on something else than the floor,
# such as a step or a treadmill.
_LOWEST, _HIGHEST = 0.5, 2.0


def standing_ankle_m(motion: SkeletonMotion, floor: Floor | None) -> float | None:
    """Median height (metres) of a person's ankles above the floor while heel and toe of the foot stand on it.

    ``None`` without a floor, for a person who does not stand, and for one whose feet stand elsewhere than on the floor.
    """
    if floor is None:
        return None
    heights_m = []
    for side in ("left", "right"):
        stands = {part: np.zeros(len(motion.root_m), bool) for part in ("heel", "toe")}
        for contact in motion.contacts:
            if contact.side == side and contact.part in stands:
                stands[contact.part][contact.rows] = True
        ankle_m, _ = joint_pose(motion, f"{side.capitalize()}Foot")
        heights_m.append(floor.height_m(ankle_m[stands["heel"] & stands["toe"]]))
    found_m = np.concatenate(heights_m)
    usual_m = -rest_offsets_m(motion.bone_length_m)[INDEX["LeftFootEnd"], 2]
    median_m = float(np.median(found_m)) if len(found_m) else np.nan
    return median_m if _LOWEST * usual_m <= median_m <= _HIGHEST * usual_m else None
