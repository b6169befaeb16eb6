"""Motion of a person on the bones of another skeleton.

Bones turn as the person's joints turn out of the T-pose, after the bones of arms and legs were turned into that T-pose:
characters may rest in an A-pose, and face any way. The middle of the hips follows the person's, scaled by the length of
the legs, so that feet stay near the floor. Bones without a joint keep their rest pose. Contacts are not fitted; the
service does that for characters that it knows.
"""

import json
import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from api.blender.extension.answers import RequestError
from api.blender.extension.bone_tree import BoneMap
from api.blender.extension.glb_motion import PersonMotion
from api.blender.extension.turns import (
    NO_TURN,
    Quat,
    Vec,
    between,
    inverse,
    length,
    minus,
    plus,
    scaled,
    times,
    turn_to,
    turned,
    unit_turn,
)
from pipeline.export.character.bone_names import HEAD, HIPS, SIDES

# Joints of the person's trunk from below, and the places on the spine at which they turn.
_TRUNK = (HIPS, "Spine", "Chest")
_NECK = ("Chest", "Neck")
_HEAD, _CHUNK = struct.Struct("<4sII"), struct.Struct("<I4s")


@dataclass(frozen=True, slots=True)
class RestBone:
    """Bone of an armature in its rest pose."""

    parent: str | None
    # Head of the bone and its axes, in the armature's space
    head: Vec
    axes: Quat
    inherits_rotation: bool = True


@dataclass(frozen=True, slots=True)
class RestArmature:
    """Armature in its rest pose, and its place in the world: ``world = place + turn(size * point)``."""

    bones: Mapping[str, RestBone]  # Parents before their children
    place_m: Vec
    turn: Quat
    size: float

    def head_m(self, bone: str) -> Vec:
        """Head of a bone in the rest pose, in the world."""
        return plus(self.place_m, turned(self.turn, scaled(self.bones[bone].head, self.size)))


@dataclass(frozen=True, slots=True)
class PoseFrame:
    """Pose of a frame: rotations of bones out of their rest pose, and the location of the hips' bone in its axes."""

    turns: Mapping[str, Quat]
    hips: Vec


class Retargeting:
    """Motion of a person put on an armature, frame by frame.

    Raises ``RequestError`` if the person's skeleton is not the service's, or legs have no length.
    """

    def __init__(self, motion: PersonMotion, armature: RestArmature, bones: BoneMap) -> None:
        missing = [joint for joint in (*_TRUNK, *_NECK, HEAD) if joint not in motion.parents]
        if missing:
            raise RequestError("The file's skeleton has other joints than the service's. Choose a GLB of a person.")
        self._motion, self._armature = motion, armature
        self._joints = {bone: joint for joint, bone in bones.bones.items() if joint in motion.parents}
        self._hips = bones.bones[HIPS]
        self._shares = {
            **_shares(bones.spine, _TRUNK),
            **_shares(bones.neck, _NECK),
        }
        self._rest_m = rest_joints_m(motion)
        self._facing = self._to_person(bones)
        self._aligned = self._aligned_axes(bones)
        self._scale, self._lift_m, self._middle_m, self._from_hips_m = self._sizes(bones)

    def frames(self) -> Iterator[PoseFrame]:
        """Poses of all frames."""
        motion = self._motion
        for frame, root_m in enumerate(motion.roots_m):
            yield self.pose({joint: unit_turn(keys[frame]) for joint, keys in motion.turns.items()}, root_m)

    def pose(self, local: Mapping[str, Quat], root_m: Vec) -> PoseFrame:
        """Pose of the armature for rotations of the person's joints in their parents, and the place of the root."""
        armature, to_armature = self._armature, inverse(self._armature.turn)
        joints: dict[str, Quat] = {}
        for joint, above in self._motion.parents.items():
            turn = local.get(joint, NO_TURN)
            joints[joint] = turn if above is None else times(joints[above], turn)
        posed: dict[str, Quat] = {}
        own: dict[str, Quat] = {}
        for name, bone in armature.bones.items():
            if bone.parent is None or not bone.inherits_rotation:
                unposed = bone.axes
            else:
                parent = armature.bones[bone.parent]
                unposed = times(posed[bone.parent], times(inverse(parent.axes), bone.axes))
            bone_turn = self._bone_turn(name, joints)
            if bone_turn is None:
                posed[name] = unposed
            else:
                posed[name] = times(to_armature, times(bone_turn, self._aligned[name]))
                own[name] = unit_turn(times(inverse(unposed), posed[name]))
        hips = armature.bones[self._hips]
        middle_m = plus(root_m, turned(joints[HIPS], self._middle_m))
        middle_m = plus(scaled(middle_m, self._scale), (0.0, 0.0, self._lift_m))
        head_m = minus(middle_m, turned(joints[HIPS], self._from_hips_m))
        head = scaled(turned(to_armature, minus(head_m, armature.place_m)), 1.0 / armature.size)
        return PoseFrame(own, turned(inverse(hips.axes), minus(head, hips.head)))

    def _bone_turn(self, bone: str, joints: Mapping[str, Quat]) -> Quat | None:
        if bone in self._joints:
            return joints[self._joints[bone]]
        if bone in self._shares:
            below, above, share = self._shares[bone]
            return between(joints[below], joints[above], share)
        return None

    def _to_person(self, bones: BoneMap) -> Quat:
        """Rotation of the world by which the armature at rest stands and faces as the person at rest does."""

        def frame(hips: Sequence[Vec], shoulders: Sequence[Vec]) -> tuple[Vec, Vec]:
            across = plus(minus(hips[0], hips[1]), minus(shoulders[0], shoulders[1]))
            up = minus(scaled(plus(*shoulders), 0.5), scaled(plus(*hips), 0.5))
            return across, up

        joints = [[f"{side}{joint}" for side in SIDES] for joint in ("UpLeg", "Arm")]
        across, up = frame(*([self._armature.head_m(bones.bones[joint]) for joint in pair] for pair in joints))
        own_across, own_up = frame(*([self._rest_m[joint] for joint in pair] for pair in joints))
        upright = turn_to(up, own_up)
        # About the axis that goes up; what is across is turned without what it has along this axis.
        across = turned(upright, across)
        axis = scaled(own_up, 1.0 / (length(own_up) or 1.0))
        flat = [minus(way, scaled(axis, sum(map(_product, way, axis)))) for way in (across, own_across)]
        return times(turn_to(*flat), upright)

    def _aligned_axes(self, bones: BoneMap) -> dict[str, Quat]:
        """Axes of bones in the world after they were turned into the person's T-pose."""
        armature, aligned = self._armature, {}
        chains: list[Sequence[str]] = []
        for side in SIDES:
            chains.append([f"{side}{joint}" for joint in ("UpLeg", "Leg", "Foot")])
            arm = [f"{side}{joint}" for joint in ("Arm", "ForeArm", "Hand")]
            chains.append(arm)
            hand = sorted(joint for joint in bones.bones if joint.startswith(f"{side}Hand") and joint not in arm)
            fingers = {joint[:-1] for joint in hand}
            chains += [[*arm, *(joint for joint in hand if joint[:-1] == finger)] for finger in sorted(fingers)]
        turns: dict[str, Quat] = {}
        for chain in chains:
            turn = self._facing
            for place, joint in enumerate(chain):
                following = chain[place + 1] if place + 1 < len(chain) else None
                is_palm = joint in {"LeftHand", "RightHand"}
                if joint in bones.bones and following in bones.bones and following in self._rest_m and not is_palm:
                    way = minus(armature.head_m(bones.bones[following]), armature.head_m(bones.bones[joint]))
                    own = minus(self._rest_m[following], self._rest_m[joint])
                    turn = times(turn_to(turned(turn, way), own), turn)
                # Feet and toes rest as they stand.
                turns.setdefault(joint, self._facing if joint.endswith("Foot") else turn)
        for name, bone in armature.bones.items():
            joint = self._joints.get(name, "")
            turn = turns.get(joint, self._facing)
            aligned[name] = times(turn, times(armature.turn, bone.axes))
        return aligned

    def _sizes(self, bones: BoneMap) -> tuple[float, float, Vec, Vec]:
        """Scale of places, lift (metres), middle between the hip joints from the person's root and from the bone."""

        def leg_m(heads: Mapping[str, Vec], side: str) -> float:
            hip, knee, ankle = (heads[f"{side}{joint}"] for joint in ("UpLeg", "Leg", "Foot"))
            return length(minus(hip, knee)) + length(minus(knee, ankle))

        def middle(heads: Mapping[str, Vec], joint: str) -> Vec:
            return scaled(plus(heads[f"Left{joint}"], heads[f"Right{joint}"]), 0.5)

        heads = {
            joint: turned(self._facing, minus(self._armature.head_m(bone), self._armature.place_m))
            for joint, bone in bones.bones.items()
        }
        own_m, legs_m = (sum(leg_m(places, side) for side in SIDES) for places in (self._rest_m, heads))
        if own_m <= 0.0 or legs_m <= 0.0:
            raise RequestError("The legs of the armature have no length. Check the bones.")
        scale = legs_m / own_m
        # Ankles are as high as the character's above the floor, on which its origin lies.
        lift_m = middle(heads, "Foot")[2] - scale * middle(self._rest_m, "Foot")[2]
        return (
            scale,
            lift_m,
            minus(middle(self._rest_m, "UpLeg"), self._rest_m[HIPS]),
            minus(middle(heads, "UpLeg"), heads[HIPS]),
        )


def _product(a: float, b: float) -> float:
    return a * b


def _shares(bones: Sequence[str], joints: Sequence[str]) -> dict[str, tuple[str, str, float]]:
    """Joints of the person between which each bone of the trunk turns, and its share of the way."""
    shares = {}
    for number, bone in enumerate(bones, 1):
        place = number / len(bones) * (len(joints) - 1)
        below = min(int(place), len(joints) - 2)
        shares[bone] = (joints[below], joints[below + 1], place - below)
    return shares


def rest_joints_m(motion: PersonMotion) -> dict[str, Vec]:
    """Places of the person's joints in the rest pose, in metres."""
    places: dict[str, Vec] = {}
    for joint, parent in motion.parents.items():
        offset = motion.offsets_m[joint]
        places[joint] = offset if parent is None else plus(places[parent], offset)
    return places


def armature_glb(armature: RestArmature) -> bytes:
    """Bones of an armature in the rest pose as a GLB without a mesh, Y up.

    The file has the places of the bones' heads alone: recognition asks for no axes.
    """
    bones = armature.bones
    numbers = {name: number for number, name in enumerate(bones)}
    children: dict[str | None, list[int]] = {}
    for name, bone in bones.items():
        children.setdefault(bone.parent, []).append(numbers[name])
    nodes: list[Mapping[str, object]] = []
    for name, bone in bones.items():
        above = (0.0, 0.0, 0.0) if bone.parent is None else bones[bone.parent].head
        x, y, z = (own - other for own, other in zip(bone.head, above, strict=True))
        below = {"children": children[name]} if name in children else {}
        nodes.append({"name": name, "translation": [x, z, -y], **below})
    document = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": children[None]}], "nodes": nodes}
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    size = _HEAD.size + _CHUNK.size + len(text)
    return _HEAD.pack(b"glTF", 2, size) + _CHUNK.pack(len(text), b"JSON") + text
