"""VMC: skeletons of a live capture to receivers of the Virtual Motion Capture protocol, OSC over UDP.

Messages and conventions: https://protocol.vmc.info/english. Bones have the names of Unity's humanoid. Unity's world is
left-handed in metres, Y up, and a humanoid faces +Z with its left side at -X; ours is right-handed, Z up, and the rest
pose faces -Y with its left side at +X. So a position (x, y, z) becomes (-x, z, -y), and a rotation (x, y, z, w) becomes
(x, -z, y, w): the axis turns with the positions, and the mirrored handedness turns its sign.
"""

import ipaddress
import socket
from collections.abc import Iterable, Iterator
from types import TracebackType

import numpy as np
from jaxtyping import Float
from pythonosc.osc_bundle import OscBundle
from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder
from pythonosc.osc_message import OscMessage
from pythonosc.osc_message_builder import OscMessageBuilder

from pipeline.core.errors import InputError, Problem
from pipeline.core.problems.finding_codes import PARAMETER_RANGE
from pipeline.motion.skeleton.humanoid import UNITY_BONES
from pipeline.motion.skeleton.model import SKELETON, rest_offsets_m
from pipeline.run.live.records import LiveInstant, LivePerson, LiveSkeleton

PORT = 39539
"""Port on which receivers of VMC listen."""

_BONES = tuple((place, UNITY_BONES[joint.name]) for place, joint in enumerate(SKELETON) if joint.name in UNITY_BONES)
_IDENTITY = (0.0, 0.0, 0.0, 1.0)


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


def vmc_messages(person: LivePerson, time_s: float) -> Iterator[OscMessage]:
    """Messages of an instant of a person: availability, time, root and all bones.

    Without a skeleton the person is not available, and there is nothing but that and the time. The root stays at
    Unity's origin, and the hips move.
    """
    skeleton = person.skeleton
    yield _message("/VMC/Ext/OK", int(skeleton is not None))
    yield _message("/VMC/Ext/T", float(time_s))
    if skeleton is None:
        return
    yield _message("/VMC/Ext/Root/Pos", "root", 0.0, 0.0, 0.0, *_IDENTITY)
    positions_m = unity_position(local_offsets_m(skeleton)).tolist()
    rotations = unity_rotation(skeleton.parent_from_joint).tolist()
    for place, bone in _BONES:
        yield _message("/VMC/Ext/Bone/Pos", bone, *positions_m[place], *rotations[place])


def vmc_bundle(person: LivePerson, time_s: float) -> OscBundle:
    """Messages of an instant of a person in a bundle, which receivers apply at once."""
    bundle = OscBundleBuilder(IMMEDIATELY)
    for message in vmc_messages(person, time_s):
        bundle.add_content(message)
    return bundle.build()


def _message(address: str, *values: str | float) -> OscMessage:
    message = OscMessageBuilder(address)
    for value in values:
        message.add_arg(value)
    return message.build()


class VmcSender:
    """Sender of people to receivers of VMC, one port a person; to be used in a ``with`` block.

    A receiver shows one person, so person number n goes to the n-th of ``ports``; people without a port are left out.

    Parameters
    ----------
    host
        Address of the receivers: a name or an IP address.
    ports
        Ports of the receivers.
    allow_network
        Whether ``host`` may be another machine: the protocol knows neither keys nor encryption.

    Raises
    ------
    InputError
        If the address is unknown, or another machine's and not allowed; or if a port is wrong.

    Examples
    --------
    >>> with VmcSender("127.0.0.1", [39540, 39541]) as sender:
    ...     isinstance(sender, VmcSender)
    True
    """

    def __init__(self, host: str = "127.0.0.1", ports: Iterable[int] = (PORT,), *, allow_network: bool = False) -> None:
        self._ports = tuple(ports)
        if not self._ports or not all(1 <= port <= 65_535 for port in self._ports):
            raise InputError([Problem(PARAMETER_RANGE, "Ports are numbers from 1 to 65535.", field="ports")])
        self._family, self._address = _resolved(host, allow_network)

    def __enter__(self) -> "VmcSender":
        self._socket = socket.socket(self._family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._socket.close()

    def send(self, instant: LiveInstant) -> int:
        """Send the people of an instant; return how many. A packet that can't be sent now is lost, as UDP may."""
        num_sent = 0
        for person in instant.people:
            if 1 <= person.id <= len(self._ports):
                num_sent += self._send(vmc_bundle(person, instant.time_s).dgram, self._ports[person.id - 1])
        return num_sent

    def _send(self, packet: bytes, port: int) -> bool:
        try:
            self._socket.sendto(packet, (self._address, port))
        except OSError:  # no room, no listener, no network now
            return False
        return True


def _resolved(host: str, allow_network: bool) -> tuple[socket.AddressFamily, str]:
    try:
        family, _, _, _, address = socket.getaddrinfo(host, None, type=socket.SOCK_DGRAM)[0]
    except (OSError, UnicodeError):
        message = "The address of the receiver is not known."
        raise InputError([Problem(PARAMETER_RANGE, message, field="host")]) from None
    resolved = str(address[0])
    if not allow_network and not ipaddress.ip_address(resolved.partition("%")[0]).is_loopback:
        message = "The receiver is on another machine, and VMC has neither keys nor encryption."
        hint = "Send to 127.0.0.1, or allow the network."
        raise InputError([Problem(PARAMETER_RANGE, message, field="host", hint=hint)])
    return family, resolved
