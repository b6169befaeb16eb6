"""Receivers of all protocols for four people: each reads instants, and gives poses in our joints and axes.

Qualisys' and LSL's are the clients of others, VMC's is the reader of the extension for Blender, OSC's is python-osc;
MVN and Rokoko are read by their documents.
"""

import asyncio
import json
import queue
import socket
import struct
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field, replace
from typing import Any, Self

import lz4.frame
import numpy as np
import qtm_rt
from defusedxml import ElementTree
from pythonosc.osc_packet import OscPacket
from scipy.spatial.transform import Rotation

from api.blender.extension.vmc_person import VmcPerson
from pipeline.motion.angles.compute import segment_angles
from pipeline.motion.body_segments import ANGLE_NAMES, SEGMENTS
from pipeline.motion.skeleton.humanoid import UNITY_BONES
from pipeline.motion.skeleton.model import INDEX
from pipeline.run.live.outputs.runner import LiveOutputs
from pipeline.run.live.records import LiveInstant, LivePerson
from tests.pipeline.run.live.outputs import test_mvn, test_qtm, test_rokoko
from tests.pipeline.run.live.outputs.people import angle_deg, skeleton_of, world_matrices
from tests.ports import free_port

NUM_PEOPLE = 4
WAIT_S = 60.0


@dataclass(slots=True)
class ReceivedPose:
    """Numbers of a person that a receiver has got, by name."""

    marks_m: dict[str, Any] = field(default_factory=dict)  # Joints of the detector
    joints_m: dict[str, Any] = field(default_factory=dict)  # Joints of the skeleton
    turns: dict[str, np.ndarray] = field(default_factory=dict)  # Rotations of the joints in the world
    angles_deg: dict[str, float] = field(default_factory=dict)


def differences(pose: ReceivedPose, person: LivePerson, marks: Sequence[str]) -> tuple[float, float]:
    """Largest difference from a person in millimetres, and in degrees."""
    skeleton, world = skeleton_of(person), world_matrices(skeleton_of(person))
    places_m = [(place_m, person.xyz_m[marks.index(name)]) for name, place_m in pose.marks_m.items()]
    places_m += [(place_m, skeleton.joint_m[INDEX[name]]) for name, place_m in pose.joints_m.items()]
    got_m, expected_m = (np.array(side) for side in zip(*places_m, strict=True))
    worst_deg = 0.0
    if pose.turns:
        expected = world[[INDEX[name] for name in pose.turns]]
        worst_deg = angle_deg(np.array(list(pose.turns.values())), expected)
    if pose.angles_deg:
        segments = {name: (world[INDEX[s.joint]] @ s.rest_from_segment)[None] for name, s in SEGMENTS.items()}
        expected_deg = dict(zip(ANGLE_NAMES, np.degrees(segment_angles(segments)[0]), strict=True))
        # A shoulder has two triples for one rotation; a finished session takes the one next to the frame before.
        compared = [name for name in pose.angles_deg if "shoulder" not in name]
        off_deg = (pose.angles_deg[name] - expected_deg[name] for name in compared)
        worst_deg = max(worst_deg, *(abs((off + 180) % 360 - 180) for off in off_deg))
    return 1e3 * float(np.nanmax(np.linalg.norm(got_m - expected_m, axis=-1))), worst_deg


class OutputReceiver(ABC):
    """Receiver of a protocol in a ``with`` block; ``read`` gives the next instant as it comes, ``decode`` its poses."""

    def __init__(self, address: str) -> None:
        self.address = address
        self._opened = ExitStack()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._opened.close()

    def connect(self) -> None:  # noqa: B027 - receivers of datagrams are not connected
        """Connect, while instants are sent."""

    @abstractmethod
    def read(self, timeout_s: float = WAIT_S) -> Any:
        """Read the next instant; raises ``TimeoutError``."""

    def drain(self) -> None:
        """Read what has come."""
        with suppress(TimeoutError):
            while True:
                self.read(0.3)

    @abstractmethod
    def decode(self, content: Any) -> list[ReceivedPose]:
        """Poses of the people, in the order of their places."""


class DatagramReceiver(OutputReceiver):
    """Receiver of datagrams; ``is_last`` tells the last one of an instant at a port."""

    def __init__(
        self,
        address: str,
        decode: Callable[[list[bytes]], list[ReceivedPose]],
        num_ports: int = 1,
        is_last: Callable[[bytes], bool] = lambda _: True,
    ) -> None:
        self._port, self._num_ports, self._is_last, self._decode = free_port(), num_ports, is_last, decode
        super().__init__(address.format(port=self._port))

    def __enter__(self) -> Self:
        self._sockets = [
            self._opened.enter_context(socket.socket(type=socket.SOCK_DGRAM)) for _ in range(self._num_ports)
        ]
        for number, receiver in enumerate(self._sockets):
            receiver.bind(("127.0.0.1", self._port + number))
        return self

    def read(self, timeout_s: float = WAIT_S) -> list[bytes]:
        packets = []
        for receiver in self._sockets:
            receiver.settimeout(timeout_s)
            packets.append(receiver.recv(65_535))
            while not self._is_last(packets[-1]):
                packets.append(receiver.recv(65_535))
        return packets

    def decode(self, content: list[bytes]) -> list[ReceivedPose]:
        return self._decode(content)


def _vmc(packets: list[bytes]) -> list[ReceivedPose]:
    poses = []
    for packet in packets:
        person = VmcPerson()
        assert person.take(packet)
        rest, (turns, root_m) = person.rest(), person.pose()
        places_m = {"Hips": np.array(root_m)}
        matrices: dict[str, np.ndarray] = {}
        for joint, parent in rest.parents.items():
            own = Rotation.from_quat(turns.get(joint, (1.0, 0.0, 0.0, 0.0)), scalar_first=True).as_matrix()
            matrices[joint] = own if parent is None else matrices[parent] @ own
            if parent is not None:
                places_m[joint] = places_m[parent] + matrices[parent] @ rest.offsets_m[joint]
        names = [joint for joint in UNITY_BONES if joint in places_m]
        poses.append(
            ReceivedPose({}, {name: places_m[name] for name in names}, {name: matrices[name] for name in names})
        )
    return poses


def _osc(packets: list[bytes]) -> list[ReceivedPose]:
    poses = []
    for packet in packets:
        values = {part.message.address.split("/")[-1]: part.message.params for part in OscPacket(packet).messages}
        assert values.pop("present") == [1.0]
        values.pop("id")
        poses.append(ReceivedPose(values))
    return poses


def _mvn(packets: list[bytes]) -> list[ReceivedPose]:
    read = [test_mvn.read_datagram(packet) for packet in packets]
    poses = []
    for datagram in (datagram for datagram in read if datagram.kind == "02"):
        joints = test_mvn.BODY if datagram.num_fingers == 0 else test_mvn.BODY | test_mvn.HANDS
        items = {item[0]: item[1:] for item in struct.iter_unpack(">I7f", datagram.content)}
        pose = ReceivedPose()
        for number, joint in joints.items():
            turn = Rotation.from_quat(items[number][3:], scalar_first=True).as_matrix()
            pose.joints_m[joint], pose.turns[joint] = items[number][:3], turn @ test_mvn.JOINT_FROM_SEGMENT.T
        poses.append(pose)
    return poses


def _rokoko(packets: list[bytes]) -> list[ReceivedPose]:
    poses, axes = [], test_rokoko.UNITY_FROM_WORLD
    for actor in json.loads(lz4.frame.decompress(packets[0]))["scene"]["actors"]:
        pose = ReceivedPose()
        for bone, (joint, reference) in (test_rokoko.REFERENCE | test_rokoko.FINGERS).items():
            if (values := actor["body"].get(bone)) is None:
                continue
            pose.joints_m[joint] = axes.T @ test_rokoko.vector(values["position"], "xyz")
            # The reference pose of thumbs is rounded to three places: 0.15 degrees.
            if "Thumb" not in bone:
                turn = Rotation.from_quat(test_rokoko.vector(values["rotation"], "xyzw"))
                pose.turns[joint] = axes.T @ (turn * Rotation.from_quat(reference).inv()).as_matrix() @ axes
        poses.append(pose)
    return poses


class QtmReceiver(OutputReceiver):
    """Client of PyPI's ``qtm-rt``: global skeletons."""

    def __init__(self) -> None:
        self._port = free_port()
        super().__init__(f"qtm://127.0.0.1:{self._port}")
        self._packets: queue.Queue[Any] = queue.Queue()
        self._loop = asyncio.new_event_loop()

    def connect(self) -> None:
        self._loop.run_until_complete(self._begin())
        thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        thread.start()

        async def disconnect() -> None:
            self._connection.disconnect()
            await asyncio.sleep(0.01)

        def end() -> None:
            asyncio.run_coroutine_threadsafe(disconnect(), self._loop).result()
            self._loop.call_soon_threadsafe(self._loop.stop)
            thread.join()
            self._loop.close()

        self._opened.callback(end)

    async def _begin(self) -> None:
        self._connection = await qtm_rt.connect("127.0.0.1", self._port + 1)
        others = {"Spine1": "Chest", "LeftToeBase": "LeftFootEnd", "RightToeBase": "RightFootEnd"}
        self._names: list[dict[int, str]] = []
        end_s = time.monotonic() + WAIT_S
        # The server may not have had its first instant yet.
        while len(self._names) < NUM_PEOPLE and time.monotonic() < end_s:
            document = ElementTree.fromstring(await self._connection.get_parameters(["skeleton"]))
            self._names = [
                {
                    int(segment.get("ID")): others.get(segment.get("Name"), segment.get("Name"))
                    for segment in body.iter("Segment")
                }
                for body in document.findall("Skeletons/Skeleton")
            ]
        assert len(self._names) == NUM_PEOPLE
        await self._connection.stream_frames(components=["skeleton:global"], on_packet=self._packets.put_nowait)

    def read(self, timeout_s: float = WAIT_S) -> Any:
        try:
            return self._packets.get(timeout=timeout_s)
        except queue.Empty:
            raise TimeoutError from None

    def decode(self, content: Any) -> list[ReceivedPose]:
        poses = []
        for names, segments in zip(self._names, content.get_skeletons()[1], strict=True):
            pose = ReceivedPose()
            for number, position_mm, rotation in segments:
                turn = Rotation.from_quat(rotation).as_matrix() @ test_qtm.JOINT_FROM_SEGMENT.T
                pose.joints_m[names[number]], pose.turns[names[number]] = np.array(position_mm) / 1e3, turn
            poses.append(pose)
        return poses


class LslReceiver(OutputReceiver):
    """Inlets of ``pylsl``: joints and angles of each person."""

    def __init__(self, name: str) -> None:
        super().__init__(f"lsl://{name}?people={NUM_PEOPLE}")
        self._name = name

    def connect(self) -> None:
        import pylsl  # noqa: PLC0415 - an extra

        self._inlets, self._labels = [], []
        for slot in range(1, NUM_PEOPLE + 1):
            for stream in ("joints", "angles"):
                (info,) = pylsl.resolve_byprop("name", f"{self._name}-{slot}-{stream}", timeout=WAIT_S)
                inlet = pylsl.StreamInlet(info, max_buflen=10)
                inlet.open_stream(WAIT_S)
                described = inlet.info(WAIT_S)  # Its elements live as long as it does.
                channel, labels = described.desc().child("channels").child("channel"), []
                while not channel.empty():
                    labels.append(channel.child_value("label"))
                    channel = channel.next_sibling()
                self._inlets.append(inlet)
                self._labels.append(labels)

    def read(self, timeout_s: float = WAIT_S) -> list[list[float]]:
        samples = [inlet.pull_sample(timeout_s)[0] for inlet in self._inlets]
        if None in samples:
            raise TimeoutError
        return samples

    def drain(self) -> None:
        for inlet in self._inlets:
            while inlet.pull_sample(0.3)[0] is not None:
                pass

    def decode(self, content: list[list[float]]) -> list[ReceivedPose]:
        poses = []
        for slot in range(NUM_PEOPLE):
            joints = [label.removesuffix("_X") for label in self._labels[2 * slot][::3]]
            points_m = np.reshape(content[2 * slot], (-1, 3))
            marks_m = {name: xyz_m for name, xyz_m in zip(joints, points_m, strict=True) if np.isfinite(xyz_m).all()}
            angles = dict(zip(self._labels[2 * slot + 1], content[2 * slot + 1], strict=True))
            poses.append(ReceivedPose(marks_m, angles_deg=angles))
        return poses


@contextmanager
def showing(outputs: LiveOutputs, instant: LiveInstant) -> Iterator[None]:
    """Show an instant again and again, so that receivers can connect; behind the block all of it was read."""
    is_over = threading.Event()

    def show() -> None:
        while not is_over.wait(0.02):
            # A skeleton that is the one of the instant before is a held pose.
            people = (replace(person, skeleton=replace(skeleton_of(person))) for person in instant.people)
            outputs.show(replace(instant, people=tuple(people)))

    thread = threading.Thread(target=show)
    thread.start()
    try:
        yield
    finally:
        is_over.set()
        thread.join()


def receivers() -> Mapping[str, OutputReceiver]:
    """Receiver of each protocol, for four people."""
    people = f"people={NUM_PEOPLE}"
    last = NUM_PEOPLE - 1
    return {
        "vmc": DatagramReceiver(f"vmc://127.0.0.1:{{port}}?{people}", _vmc, NUM_PEOPLE),
        "osc": DatagramReceiver(
            f"osc://127.0.0.1:{{port}}?{people}", _osc, is_last=lambda packet: b"/person/4/present" in packet
        ),
        "qtm": QtmReceiver(),
        "mvn": DatagramReceiver(
            "mvn://127.0.0.1:{port}", _mvn, is_last=lambda packet: packet[:6] == b"MXTP02" and packet[16] == last
        ),
        "rokoko": DatagramReceiver("rokoko://127.0.0.1:{port}", _rokoko),
        "lsl": LslReceiver(f"equal-{free_port()}"),
    }
