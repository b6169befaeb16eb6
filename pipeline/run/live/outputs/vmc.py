"""VMC: skeletons of a live capture to receivers of the Virtual Motion Capture protocol, OSC over UDP.

Messages and conventions: https://protocol.vmc.info/english. Bones have the names of Unity's humanoid. Unity's world is
left-handed in metres, Y up, and a humanoid faces +Z with its left side at -X; ours is right-handed, Z up, and the rest
pose faces -Y with its left side at +X. So a position (x, y, z) becomes (-x, z, -y), and a rotation (x, y, z, w) becomes
(x, -z, y, w): the axis turns with the positions, and the mirrored handedness turns its sign.

A receiver shows one person: ``people=3`` in the address sends three people to three ports from the stated one on, and
``person=2`` begins with the second person.
"""

from collections.abc import Iterator
from functools import cache

import numpy as np
from jaxtyping import Float

from pipeline.motion.skeleton.humanoid import UNITY_BONES
from pipeline.motion.skeleton.model import find_skeleton, rest_offsets_m
from pipeline.run.live.outputs.datagrams import DatagramOutput, OscTemplate
from pipeline.run.live.outputs.output import OutputStart
from pipeline.run.live.records import LiveInstant, LivePerson, LiveSkeleton

_AT_ORIGIN = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
_ABSENT = OscTemplate([("/VMC/Ext/OK", (0,), 0), ("/VMC/Ext/T", (), 1)])


def unity_position(xyz_m: Float[np.ndarray, "*any 3"]) -> Float[np.ndarray, "*any 3"]:
    """Position in Unity's axes from one in ours, in metres.

    >>> unity_position(np.array([1.0, 2.0, 3.0])).tolist()
    [-1.0, 3.0, -2.0]
    """
    return xyz_m[..., [0, 2, 1]] * (-1.0, 1.0, -1.0)


def unity_rotation(xyzw: Float[np.ndarray, "*any 4"]) -> Float[np.ndarray, "*any 4"]:
    """Rotation in Unity's axes from one in ours, as quaternions (x, y, z, w).

    >>> unity_rotation(np.array([0.1, 0.2, 0.3, 0.9])).tolist()
    [0.1, -0.3, 0.2, 0.9]
    """
    return xyzw[..., [0, 2, 1, 3]] * (1.0, -1.0, 1.0, 1.0)


def local_offsets_m(skeleton: LiveSkeleton) -> Float[np.ndarray, "bones 3"]:
    """Position of each joint in its parent's frame, in metres and our axes; of the root in the world."""
    offsets_m = rest_offsets_m(skeleton.bone_length_m)
    offsets_m[0] = skeleton.root_m
    return offsets_m


@cache
def _pose(num_joints: int) -> tuple[list[int], OscTemplate]:
    """Places of the bones that are sent of a skeleton, and the packet."""
    places = {place: joint.name for place, joint in enumerate(find_skeleton(num_joints)) if joint.name in UNITY_BONES}
    messages = [("/VMC/Ext/Bone/Pos", (UNITY_BONES[name],), 7) for name in places.values()]
    root = "/VMC/Ext/Root/Pos", ("root",), 7
    return list(places), OscTemplate([("/VMC/Ext/OK", (1,), 0), ("/VMC/Ext/T", (), 1), root, *messages])


def vmc_packet(person: LivePerson, time_s: float) -> bytes:
    """Packet of a person at an instant: availability, time, root and all bones.

    Without a skeleton the person is not available, and there is nothing but this and the time. The root stays at
    Unity's origin, and the hips move.
    """
    skeleton = person.skeleton
    if skeleton is None:
        return _ABSENT.packet([time_s])
    places, template = _pose(len(skeleton.bone_length_m))
    positions_m = unity_position(local_offsets_m(skeleton))[places]
    rotations = unity_rotation(skeleton.parent_from_joint)[places]
    return template.packet([time_s, *_AT_ORIGIN, *np.hstack([positions_m, rotations]).ravel()])


class VmcOutput(DatagramOutput):
    """Output of VMC, a port a person; see ``LiveOutput``."""

    def __init__(self, start: OutputStart) -> None:
        first = int(start.address.options.get("person", 1))
        self.num_ports = int(start.address.options.get("people", 1))
        super().__init__(start, first - 1 + self.num_ports)

    def packets(self, instant: LiveInstant) -> Iterator[tuple[int, bytes]]:
        """See ``DatagramOutput``."""
        people = self.slots.update(instant)[-self.num_ports :]
        for port, person in enumerate(people, self.address.port):
            if person is not None:
                yield port, vmc_packet(person, instant.time_s)
