"""Person of a live capture, from messages of the Virtual Motion Capture protocol (https://protocol.vmc.info/english).

Messages have local places and rotations of the bones of Unity's humanoid, in its axes: left-handed, Y up, the rest pose
is a T-pose that faces +Z. Here the axes are those of ``glb_motion``: right-handed, Z up, the rest pose faces -Y.
"""

from collections.abc import Mapping
from typing import Any

from api.blender.extension.glb_motion import PersonMotion
from api.blender.extension.osc import messages_of
from api.blender.extension.turns import NO_TURN, Quat, Vec, length, plus, times, turned, unit_turn
from pipeline.export.character.bone_names import HIPS, REQUIRED, SIDES
from pipeline.motion.skeleton.humanoid import UNITY_BONES

_UPPER_CHEST = "UpperChest"  # Some senders have this bone; Multicap's skeleton lacks it.
_JOINTS = {bone: joint for joint, bone in UNITY_BONES.items()} | {_UPPER_CHEST: _UPPER_CHEST}
_LIMBS = ((_UPPER_CHEST, "Shoulder", "Arm", "ForeArm", "Hand"), (HIPS, "UpLeg", "Leg", "Foot"))
_TRUNK = (HIPS, "Spine", "Chest", _UPPER_CHEST, "Neck", "Head")
_MAX_NUMBER = 1e4
# Height of the ankle over the floor, as a share of thigh and shin (Winter, "Biomechanics and Motor Control of Human
# Movement", 2009: 0.039 and 0.491 of the stature).
_ANKLE_SHARE = 0.08
_SAME_M = 1e-3


def _parents() -> dict[str, str | None]:
    parents: dict[str, str | None] = dict(zip(_TRUNK, (None, *_TRUNK), strict=False))
    for side in SIDES:
        for above, *joints in _LIMBS:
            for joint in joints:
                parents[f"{side}{joint}"] = above
                above = f"{side}{joint}"  # noqa: PLW2901 - the next joint hangs on it
    return parents


_PARENTS = _parents()


class VmcPerson:
    """Latest pose of a person of whom packets tell."""

    def __init__(self) -> None:
        self._places_m: dict[str, Vec] = {}  # Of joints in their parents
        self._turns: dict[str, Quat] = {}
        self._root: tuple[Vec, Quat] = (0.0, 0.0, 0.0), NO_TURN
        self.is_new = False
        """Return whether bones have come since the last pose."""

    def take(self, packet: bytes) -> bool:
        """Take a packet; return whether it is OSC. Messages of other programs and wrong numbers are passed over."""
        try:
            for address, values in messages_of(packet):
                self._take(address, values)
        except ValueError:
            return False
        return True

    def _take(self, address: str, values: tuple[Any, ...]) -> None:
        if address not in {"/VMC/Ext/Bone/Pos", "/VMC/Ext/Root/Pos"} or len(values) < 8:
            return
        name, *numbers = values[:8]
        if not all(isinstance(number, float) and abs(number) <= _MAX_NUMBER for number in numbers):
            return
        x, y, z, qx, qy, qz, qw = numbers
        place_m, turn = (-x, -z, y), unit_turn((qw, qx, qz, -qy))
        if address == "/VMC/Ext/Root/Pos":
            self._root = place_m, turn
        elif (joint := _JOINTS.get(name)) is not None:
            self._places_m[joint], self._turns[joint] = place_m, turn
            self.is_new = True

    @property
    def is_complete(self) -> bool:
        """Return whether all bones have come that an armature needs."""
        return all(joint in self._turns for joint in (HIPS, *REQUIRED))

    def rest(self) -> PersonMotion:
        """Skeleton of the person, without motion; bones that the sender lacks have no length."""
        offsets_m = {joint: self._places_m.get(joint, (0.0, 0.0, 0.0)) for joint in _PARENTS}
        legs = [[offsets_m[f"{side}{joint}"] for joint in ("UpLeg", "Leg", "Foot")] for side in SIDES]
        drop_m = -sum(offset[2] for leg in legs for offset in leg) / len(legs)
        legs_m = sum(length(offset) for leg in legs for offset in leg[1:]) / len(legs)
        offsets_m[HIPS] = (0.0, 0.0, drop_m + _ANKLE_SHARE * legs_m)
        return PersonMotion(1.0, _PARENTS, offsets_m, (), {})

    def pose(self) -> tuple[Mapping[str, Quat], Vec]:
        """Rotations of the joints in the world, and the place of the root in metres."""
        self.is_new = False
        root_m, root_turn = self._root
        turns: dict[str, Quat] = {}
        for joint, parent in _PARENTS.items():
            above = root_turn if parent is None else turns[parent]
            turns[joint] = times(above, self._turns.get(joint, NO_TURN))
        return turns, plus(root_m, turned(root_turn, self._places_m[HIPS]))


def is_same_person(first: PersonMotion, second: PersonMotion) -> bool:
    """Return whether two skeletons have bones of the same lengths."""
    return all(
        abs(a - b) <= _SAME_M
        for joint, offset_m in first.offsets_m.items()
        for a, b in zip(offset_m, second.offsets_m[joint], strict=True)
    )
