"""Measures of a character for retargeting: axes, rest pose, limbs, feet and scale.

Everything is in the axes of the skeleton, Z up and facing -Y, and in the character's unit of length. The skeleton rests
in a T-pose. A character rests as it likes; ``upright`` turns each bone from there to where it is in the T-pose, so that
arms and legs have the directions that the skeleton's have.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from pipeline.core.data.arrays import read_only
from pipeline.core.errors import InputError, Problem, printable
from pipeline.core.joints import FINGERS
from pipeline.core.problems.session_codes import CHARACTER_BONES
from pipeline.export.character.bone_names import HEAD, HIPS, SIDES
from pipeline.export.character.gltf_reader import CharacterFile
from pipeline.export.character.mapping import BoneMapping, connected
from pipeline.export.character.rig import CharacterRig
from pipeline.motion.skeleton.model import INDEX, WHOLE_SKELETON

_DOWN = np.array([0.0, 0.0, -1.0])
_FORWARD = np.array([0.0, -1.0, 0.0])
_OUTWARDS: Mapping[str, Float[np.ndarray, " 3"]] = {
    "Left": np.array([1.0, 0.0, 0.0]),
    "Right": np.array([-1.0, 0.0, 0.0]),
}
# Angle up to which the file's axes are kept: a body that leans a little in its rest pose stands on a level floor.
_SNAP_DEG = 25.0
_UNEVEN = 0.01
# Measures of feet without a mesh, as shares of the leg's length: height of the ankle, and way from it to heel and toes.
_ANKLE, _HEEL, _TIP = 0.08, 0.06, 0.2
# Height above the sole, as a share of the ankle's, up to which points of a foot are of its sole.
_SOLE = 0.4


@dataclass(frozen=True, slots=True, eq=False)
class FootMeasures:
    """Measures of a foot in the T-pose, from its ankle."""

    heel: Float[np.ndarray, " 3"]  # Hindmost point of the sole
    ball: Float[np.ndarray, " 3"]  # Point of the sole about which the foot rolls: under its toes' joint, or their tip

    @property
    def ankle_height(self) -> float:
        """Height of the ankle above the sole."""
        return -float(self.heel[2])


@dataclass(frozen=True, slots=True, eq=False)
class CharacterFigure:
    """A character whose bones are known."""

    file: CharacterFile
    mapping: BoneMapping
    rig: CharacterRig  # Nodes of the file, with hands and feet below their limbs
    skeleton_from_file: Float[np.ndarray, "3 3"]  # Rotation from the file's axes to the skeleton's
    joints: Mapping[str, int]  # Nodes by joint
    positions: Float[np.ndarray, "nodes 3"]  # Positions of all nodes in the rest pose
    upright: Mapping[int, Float[np.ndarray, "3 3"]]  # Rotation of each node with a joint from the rest to the T-pose
    feet: Mapping[str, FootMeasures]  # Feet by side

    def length(self, start: str, end: str) -> float:
        """Distance between the bones of two joints in the rest pose."""
        return float(np.linalg.norm(self.positions[self.joints[end]] - self.positions[self.joints[start]]))

    @property
    def leg_length(self) -> float:
        """Length of thigh and shin, the mean of both legs."""
        legs = [self.length(f"{s}UpLeg", f"{s}Leg") + self.length(f"{s}Leg", f"{s}Foot") for s in SIDES]
        return sum(legs) / len(SIDES)


def measure(file: CharacterFile, mapping: BoneMapping) -> CharacterFigure:
    """Measure a character. Raises ``InputError`` if a limb has no length, or bones are scaled unevenly or mirrored."""
    joints = {joint: file.rig.names.index(bone) for joint, bone in mapping.bones.items()}
    _require_turnable(file, joints)
    rig, _ = connected(file.rig, joints)
    turn = _skeleton_from_file(rig, joints)
    positions = rig.positions @ turn.T
    upright = _upright(rig, joints, positions)
    mesh = [(skinned.positions @ turn.T, skinned.bones) for skinned in file.skinned]
    leg = np.mean([np.linalg.norm(positions[joints[f"{s}Foot"]] - positions[joints[f"{s}UpLeg"]]) for s in SIDES])
    feet = {side: _foot(rig, joints, positions, upright, mesh, side, float(leg)) for side in SIDES}
    return CharacterFigure(file, mapping, rig, read_only(turn), joints, read_only(positions), upright, feet)


def _require_turnable(file: CharacterFile, joints: Mapping[str, int]) -> None:
    """Raise ``InputError`` if bones have no length, or are scaled unevenly: turned, they would be sheared."""
    rig, problems = file.rig, []
    above = {node for number in joints.values() for node in rig.ancestors(number)}
    for node in sorted(above):
        scaled = rig.worlds[node, :3, :3]
        scales = np.linalg.norm(scaled, axis=0)
        if np.linalg.det(scaled) <= 0.0 or scales.max() - scales.min() > _UNEVEN * scales.max():
            message = f"The node {printable(rig.names[node])} is mirrored, or scaled differently along its axes."
            hint = "Apply the scale of the armature before the export."
            problems.append(Problem(CHARACTER_BONES, message, file=file.name, hint=hint))
    for side in SIDES:
        for start, end in (("UpLeg", "Leg"), ("Leg", "Foot"), ("Arm", "ForeArm"), ("ForeArm", "Hand")):
            first, last = (rig.positions[joints[f"{side}{joint}"]] for joint in (start, end))
            if not np.linalg.norm(last - first) > 0.0:
                message = f"The bone of {side}{start} has no length."
                problems.append(Problem(CHARACTER_BONES, message, file=file.name))
    if problems:
        raise InputError(problems)


def _skeleton_from_file(rig: CharacterRig, joints: Mapping[str, int]) -> Float[np.ndarray, "3 3"]:
    """Rotation to the skeleton's axes: from feet to shoulders is up, from right to left is x."""

    def middle(joint: str) -> Float[np.ndarray, " 3"]:
        return sum((rig.positions[joints[f"{side}{joint}"]] for side in SIDES), np.zeros(3)) / len(SIDES)

    up = _unit(middle("Arm") - middle("Foot"))
    across = sum(
        (rig.positions[joints[f"Left{joint}"]] - rig.positions[joints[f"Right{joint}"]] for joint in ("UpLeg", "Arm")),
        np.zeros(3),
    )
    left = _unit(across - (across @ up) * up)
    turn = np.array([left, np.cross(up, left), up])
    # The nearest of the rotations that only rename axes: bodies stand on one of the file's planes.
    snapped = np.zeros((3, 3))
    for row, column in enumerate(np.abs(turn).argmax(1)):
        snapped[row, column] = np.sign(turn[row, column])
    is_rotation = np.linalg.det(snapped) > 0.0
    if is_rotation and np.degrees(Rotation.from_matrix(turn @ snapped.T).magnitude()) < _SNAP_DEG:
        return snapped
    return turn


def _upright(
    rig: CharacterRig, joints: Mapping[str, int], positions: Float[np.ndarray, "nodes 3"]
) -> dict[int, Float[np.ndarray, "3 3"]]:
    """Rotation of each bone with a joint from the rest pose to the T-pose."""
    turned: dict[str, Float[np.ndarray, "3 3"]] = {joint: np.eye(3) for joint in (HIPS, HEAD)}

    def along(start: str, end: str) -> Float[np.ndarray, " 3"]:
        return positions[joints[end]] - positions[joints[start]]

    def straighten(joint: str, before: Float[np.ndarray, "3 3"], bone: Float[np.ndarray, " 3"], to: Any) -> None:
        turned[joint] = _between(before @ bone, np.asarray(to, float)) @ before

    for side in SIDES:
        out = _OUTWARDS[side]
        turned[f"{side}Shoulder"] = np.eye(3)
        straighten(f"{side}UpLeg", np.eye(3), along(f"{side}UpLeg", f"{side}Leg"), _DOWN)
        straighten(f"{side}Leg", turned[f"{side}UpLeg"], along(f"{side}Leg", f"{side}Foot"), _DOWN)
        straighten(f"{side}Arm", np.eye(3), along(f"{side}Arm", f"{side}ForeArm"), out)
        straighten(f"{side}ForeArm", turned[f"{side}Arm"], along(f"{side}ForeArm", f"{side}Hand"), out)
        turned[f"{side}Foot"] = np.eye(3)
        if f"{side}ToeBase" in joints:
            # A foot keeps its sole on the floor; its toes point forward.
            toes = along(f"{side}Foot", f"{side}ToeBase") * (1.0, 1.0, 0.0)
            if np.linalg.norm(toes) > 0.0:
                turned[f"{side}Foot"] = _between(toes, _FORWARD)
        turned[f"{side}ToeBase"] = turned[f"{side}Foot"]
        turned[f"{side}Hand"] = _flat_hand(joints, positions, side, turned[f"{side}ForeArm"])
        for finger in FINGERS:
            before = turned[f"{side}Hand"]
            names = [f"{side}Hand{finger.capitalize()}{number}" for number in (1, 2, 3)]
            present = [name for name in names if name in joints]
            for number, name in enumerate(present):
                node = joints[name]
                tip = joints[present[number + 1]] if number + 1 < len(present) else next(iter(rig.children[node]), None)
                if tip is not None and np.linalg.norm(positions[tip] - positions[node]) > 0.0:
                    direction = WHOLE_SKELETON[INDEX[f"{side}Hand{finger.capitalize()}2"]].rest_direction
                    straighten(name, before, positions[tip] - positions[node], direction)
                turned[name] = before = turned.get(name, before)
    return {joints[joint]: read_only(matrix) for joint, matrix in turned.items() if joint in joints}


def _flat_hand(
    joints: Mapping[str, int],
    positions: Float[np.ndarray, "nodes 3"],
    side: str,
    before: Float[np.ndarray, "3 3"],
) -> Float[np.ndarray, "3 3"]:
    """Rotation of a hand to the T-pose: fingers outwards, palm down, as far as its fingers tell; else as the arm's."""
    bases = {
        finger: positions[joints[name]] for finger in FINGERS if (name := f"{side}Hand{finger.capitalize()}1") in joints
    }
    across = [bases[finger] for finger in ("index", "pinky") if finger in bases]
    if len(across) < len(SIDES):
        return before
    wrist, middle = positions[joints[f"{side}Hand"]], bases.get("middle", (across[0] + across[1]) / 2)
    is_now = _axes(middle - wrist, across[0] - across[1])
    rest = {finger: _finger_base(side, finger) for finger in ("index", "middle", "pinky")}
    is_then = _axes(rest["middle"], rest["index"] - rest["pinky"])
    return before if is_now is None or is_then is None else is_then @ is_now.T


def _finger_base(side: str, finger: str) -> Float[np.ndarray, " 3"]:
    """Base of a finger of the skeleton from its wrist, as shares of the stature."""
    joint = WHOLE_SKELETON[INDEX[f"{side}Hand{finger.capitalize()}1"]]
    return np.array(joint.rest_direction) * joint.stature_share


def _axes(first: Float[np.ndarray, " 3"], second: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "3 3"] | None:
    """Axes, as columns, of which the first is a vector, and the second in its plane with another one."""
    normal = np.cross(first, second)
    if not np.linalg.norm(normal) > 0.0:
        return None
    x, z = _unit(first), _unit(normal)
    return np.column_stack([x, np.cross(z, x), z])


def _foot(
    rig: CharacterRig,
    joints: Mapping[str, int],
    positions: Float[np.ndarray, "nodes 3"],
    upright: Mapping[int, Float[np.ndarray, "3 3"]],
    mesh: list[tuple[Float[np.ndarray, "vertices 3"], Any]],
    side: str,
    leg: float,
) -> FootMeasures:
    ankle = joints[f"{side}Foot"]
    toes = joints.get(f"{side}ToeBase")
    below = np.zeros(len(positions), bool)
    below[list(rig.below(ankle))] = True
    points = [vertices[below[bones]] for vertices, bones in mesh]
    points = [(vertices - positions[ankle]) @ upright[ankle].T for vertices in points if len(vertices)]
    if points:
        of_foot = np.concatenate(points)
        sole = of_foot[:, 2].min()
        lowest = of_foot[of_foot[:, 2] < sole * (1.0 - _SOLE)] if sole < 0.0 else of_foot
        # A heel is not before the ankle, even if no vertex shows it.
        hind, front = max(lowest[:, 1].max(), 0.0), lowest[:, 1].min()
    else:
        sole, hind, front = -_ANKLE * leg, _HEEL * leg, -_TIP * leg
        if toes is not None:
            sole = min(sole, upright[ankle][2] @ (positions[toes] - positions[ankle]))
    ball = front if toes is None else upright[ankle][1] @ (positions[toes] - positions[ankle])
    return FootMeasures(np.array([0.0, hind, sole]), np.array([0.0, min(ball, hind), sole]))


def _between(start: Float[np.ndarray, " 3"], end: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "3 3"]:
    """Smallest rotation from one direction to another."""
    first, second = _unit(start), _unit(end)
    axis, cosine = np.cross(first, second), float(first @ second)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-12:
        axis = np.cross(first, np.eye(3)[np.abs(first).argmin()])
        return np.eye(3) if cosine > 0.0 else Rotation.from_rotvec(np.pi * _unit(axis)).as_matrix()
    return Rotation.from_rotvec(axis / sine * np.arctan2(sine, cosine)).as_matrix()


def _unit(vector: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 3"]:
    return np.asarray(vector / np.linalg.norm(vector))
