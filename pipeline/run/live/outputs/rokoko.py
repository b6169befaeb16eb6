"""Rokoko: people as actors of the JSON stream of Rokoko Studio, version 3 in LZ4 frames, over UDP.

Its receivers for Blender, Unity and Unreal Engine are public, and state the form. The axes are Unity's. A rotation is
the world's, times a fixed rotation by which Rokoko's bones lie in the rest pose. Frames bear their size, which the
receiver for Unity needs; the receiver for Unreal Engine takes frames of 32,768 bytes.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from functools import cache

import lz4.frame
import numpy as np
from jaxtyping import Float

from pipeline.motion.skeleton.model import INDEX, SKELETON
from pipeline.run.live.outputs.datagrams import DatagramOutput
from pipeline.run.live.outputs.poses import person_colour, person_name, product, rest_joints_m, world_rotations
from pipeline.run.live.outputs.vmc import unity_position, unity_rotation
from pipeline.run.live.records import LiveInstant, LivePerson, LiveSkeleton

_HALF = np.sqrt(0.5)
_HIPS, _TRUNK, _SHOULDER = (0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, _HALF, -_HALF)
_ARM, _LEG, _FOOT = (-0.5, -0.5, 0.5, -0.5), (0.0, _HALF, 0.0, _HALF), (0.0, _HALF, -_HALF, 0.0)
_THUMB_BASE, _THUMB = (-0.56098, -0.70106, 0.43046, -0.0923), (-0.65328, -0.65328, 0.2706, -0.2706)

_CENTRE = {"hip": ("Hips", _HIPS), **{name.lower(): (name, _TRUNK) for name in ("Spine", "Chest", "Neck", "Head")}}
# Bones of a side: our joint and the rotation in the rest pose on the left; on the right it is mirrored.
_SIDE = {
    "Shoulder": ("Shoulder", _SHOULDER),
    **{bone: (joint, _ARM) for bone, joint in (("UpperArm", "Arm"), ("LowerArm", "ForeArm"), ("Hand", "Hand"))},
    **{bone: (bone, _LEG) for bone in ("UpLeg", "Leg")},
    **{bone: (joint, _FOOT) for bone, joint in (("Foot", "Foot"), ("Toe", "FootEnd"), ("ToeEnd", "FootEnd"))},
}
_FINGERS = {
    f"{finger}{bone}": (f"Hand{ours}{joint}", _ARM if finger != "Thumb" else _THUMB if joint != "1" else _THUMB_BASE)
    for finger, ours in (
        *(("Thumb", "Thumb"), ("Index", "Index"), ("Middle", "Middle"), ("Ring", "Ring"), ("Little", "Pinky")),
    )
    for bone, joint in (("Proximal", "1"), ("Medial", "2"), ("Distal", "3"), ("Tip", "3End"))
}
_COORDINATES = '{"position":{"x":%.5f,"y":%.5f,"z":%.5f},"rotation":{"x":%.6f,"y":%.6f,"z":%.6f,"w":%.6f}}'


@cache
def _bones(num_joints: int) -> tuple[list[int], Float[np.ndarray, "bones 4"], str]:
    """Joints of Rokoko's bones, rotations of the bones in the rest pose, and their JSON but for the numbers."""
    bones: dict[str, tuple[str, tuple[float, ...]]] = dict(_CENTRE)
    sided: Mapping[str, tuple[str, tuple[float, ...]]] = _SIDE if num_joints == len(SKELETON) else _SIDE | _FINGERS
    for side, mirror in (("left", 1.0), ("right", -1.0)):
        for bone, (joint, (x, y, z, w)) in sided.items():
            bones[side + bone] = side.capitalize() + joint, (mirror * x, y, z, mirror * w)
    rest = np.array([rotation for _, rotation in bones.values()])
    text = ",".join(f'"{bone}":{_COORDINATES}' for bone in bones)
    return [INDEX[joint] for joint, _ in bones.values()], rest / np.linalg.norm(rest, axis=-1, keepdims=True), text


def rokoko_frame(people: Sequence[tuple[LivePerson, LiveSkeleton]], time_s: float, rate_hz: float) -> bytes:
    """LZ4 frame of people with their skeletons; ``time_s`` counts from the first frame."""
    actors = []
    rotations = world_rotations([skeleton for _, skeleton in people]) if people else np.empty((0, 0, 4))
    for (person, skeleton), rotation in zip(people, rotations, strict=True):
        joints, rest, text = _bones(len(rotation))
        rest_m = rest_joints_m(skeleton.bone_length_m)
        has_fingers = len(rotation) > len(SKELETON)
        gloves = dict.fromkeys(("hasGloves", "hasLeftGlove", "hasRightGlove"), has_fingers)
        facts = {
            "name": person_name(person.id),
            "color": person_colour(person.id),
            "meta": {**gloves, "hasBody": True, "hasFace": False},
            "dimensions": {"totalHeight": round(rest_m[:, 2].max(), 5), "hipHeight": round(rest_m[0, 2], 5)},
        }
        position_m = unity_position(skeleton.joint_m[joints])
        numbers = np.hstack([position_m, product(unity_rotation(rotation[joints]), rest)])
        actors.append(f'{json.dumps(facts)[:-1]},"body":{{{text % tuple(numbers.ravel().tolist())}}}}}')
    scene = f'{{"timestamp":{time_s:.6f},"actors":[{",".join(actors)}],"props":[]}}'
    return lz4.frame.compress(f'{{"version":3.0,"fps":{rate_hz:g},"scene":{scene}}}'.encode())


class RokokoOutput(DatagramOutput):
    """Output of the JSON stream of Rokoko; see ``LiveOutput``."""

    _has_people = False  # In the last frame

    def packets(self, instant: LiveInstant) -> Iterator[tuple[int, bytes]]:
        """See ``DatagramOutput``. A frame without people follows the last one with them."""
        people = [(person, person.skeleton) for person in self.slots.update(instant) if person and person.skeleton]
        if people or self._has_people:
            self._has_people = bool(people)
            yield self.address.port, rokoko_frame(people, self.elapsed_s(instant), self.rate_hz)
