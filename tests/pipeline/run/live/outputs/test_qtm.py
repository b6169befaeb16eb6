"""Qualisys' real-time protocol: what the client of PyPI's ``qtm-rt`` gets, and peers that misbehave."""

import asyncio
import contextlib
import socket
import struct
import threading
from collections.abc import Awaitable, Callable, Iterator
from typing import Any, TypeVar

import numpy as np
import pytest
import qtm_rt
from defusedxml import ElementTree
from qtm_rt.packet import QRTComponentType, QRTEvent, QRTPacket
from qtm_rt.protocol import QRTCommandException
from scipy.spatial.transform import Rotation

from pipeline.motion.skeleton.model import SKELETON, WHOLE_SKELETON
from pipeline.run.live.outputs.addresses import OutputAddress
from pipeline.run.live.outputs.output import OutputStart
from pipeline.run.live.outputs.qtm import QtmOutput
from pipeline.run.live.records import LiveInstant, LivePerson
from tests.pipeline.run.live.outputs.people import (
    JOINTS,
    NUM_BONES,
    TOLERANCE_DEG,
    TOLERANCE_M,
    angle_deg,
    live_instant,
    skeleton_of,
    world_matrices,
)
from tests.ports import free_port

Result = TypeVar("Result")
RATE_HZ = 50.0
# Rotation from the axes of a segment, which face +Y in the rest pose, to the axes of a joint, which face -Y.
JOINT_FROM_SEGMENT = np.diag([-1.0, -1.0, 1.0])
HEADER = struct.Struct("<II")


@contextlib.contextmanager
def serving() -> Iterator[tuple[QtmOutput, int]]:
    base_port = free_port()
    with QtmOutput(OutputStart(OutputAddress("qtm", "127.0.0.1", base_port, {}), RATE_HZ, JOINTS)) as output:
        yield output, base_port


def asked(base_port: int, ask: Callable[[qtm_rt.QRTConnection], Awaitable[Result]], **options: Any) -> Result:
    """Result of a coroutine with a connection of the client."""

    async def run() -> Result:
        connection = await qtm_rt.connect("127.0.0.1", base_port + 1, **options)
        assert connection is not None
        try:
            return await ask(connection)
        finally:
            connection.disconnect()
            await asyncio.sleep(0)

    return asyncio.run(run())


@contextlib.contextmanager
def showing(output: QtmOutput, instant_at: Callable[[int], LiveInstant]) -> Iterator[None]:
    """Send instants on a thread, at twice the rate of the capture."""
    is_over = threading.Event()

    def send() -> None:
        number = 0
        while not is_over.is_set():
            output.send(instant_at(number))
            number += 1
            is_over.wait(0.5 / RATE_HZ)

    thread = threading.Thread(target=send)
    thread.start()
    try:
        yield
    finally:
        is_over.set()
        thread.join()


def streamed(base_port: int, components: list[str], num_frames: int, frames: str = "allframes") -> list[QRTPacket]:
    """Frames that a client gets after it has read the parameters."""

    async def ask(connection: qtm_rt.QRTConnection) -> list[QRTPacket]:
        await connection.get_parameters(["3d", "skeleton"])
        packets: asyncio.Queue[QRTPacket] = asyncio.Queue()
        await connection.stream_frames(frames, components=components, on_packet=packets.put_nowait)
        return [await asyncio.wait_for(packets.get(), 60) for _ in range(num_frames)]

    return asked(base_port, ask)


def received(connection: socket.socket) -> tuple[int, bytes]:
    """Type and content of the next packet."""
    size, kind = HEADER.unpack(exactly(connection, HEADER.size))
    return kind, exactly(connection, size - HEADER.size)


def exactly(connection: socket.socket, size: int) -> bytes:
    content = b""
    while len(content) < size:
        part = connection.recv(size - len(content))
        assert part
        content += part
    return content


def command(text: str) -> bytes:
    return HEADER.pack(HEADER.size + len(text) + 1, 1) + text.encode() + b"\0"


@pytest.mark.parametrize("num_joints", [NUM_BONES, len(WHOLE_SKELETON)])
@pytest.mark.parametrize("is_global", [False, True])
def test_client_gets_skeletons_of_four_people(is_global: bool, num_joints: int) -> None:
    """Segments are relative to their parents, or in the world; with fingers there are 30 more."""
    instant, name = live_instant(num_joints=num_joints), "skeleton:global" if is_global else "skeleton"
    with serving() as (output, base_port):
        output.send(instant)
        document = asked(base_port, lambda connection: connection.get_parameters(["skeleton"]))
        _, skeletons = asked(base_port, lambda connection: connection.get_current_frame([name])).get_skeletons()
    described = ElementTree.fromstring(document).findall("Skeletons/Skeleton")
    assert [skeleton.get("Name") for skeleton in described] == [f"person-{number}" for number in (1, 2, 3, 4)]
    names = {joint.name: place for place, joint in enumerate(WHOLE_SKELETON)}
    for person, element, segments in zip(instant.people, described, skeletons, strict=True):
        pose = skeleton_of(person)
        world, places = world_matrices(pose) @ JOINT_FROM_SEGMENT, {}
        got_m, got = np.full((num_joints, 3), np.nan), np.full((num_joints, 3, 3), np.nan)
        parents = {child: parent for parent in element.iter("Segment") for child in parent.findall("Segment")}
        elements = {int(segment.get("ID", "")): segment for segment in element.iter("Segment")}
        for number, position, rotation in segments:
            segment = elements[number]
            joint = {"Spine1": "Chest", "LeftToeBase": "LeftFootEnd", "RightToeBase": "RightFootEnd"}.get(
                segment.get("Name", ""), segment.get("Name", "")
            )
            place = places[segment] = names[joint]
            got_m[place], got[place] = np.array(position) / 1000, Rotation.from_quat(rotation).as_matrix()
            if not is_global and segment in parents:
                parent = places[parents[segment]]
                got_m[place], got[place] = got_m[parent] + got[parent] @ got_m[place], got[parent] @ got[place]
        is_sent = np.isfinite(got_m[:, 0])
        ends = [joint.name.endswith("End") and "Foot" not in joint.name for joint in WHOLE_SKELETON[:num_joints]]
        assert is_sent.tolist() == [not is_end for is_end in ends]
        np.testing.assert_allclose(got_m[is_sent], pose.joint_m[is_sent], atol=TOLERANCE_M)
        assert angle_deg(got[is_sent], world[is_sent]) < TOLERANCE_DEG


def test_rest_pose_of_parameters_faces_y_on_floor() -> None:
    with serving() as (output, base_port):
        output.send(live_instant([1]))
        document = asked(base_port, lambda connection: connection.get_parameters(["skeleton:global"]))
    places = {
        segment.get("Name"): np.array([float(position.get(axis, "")) for axis in "XYZ"])
        for segment in ElementTree.fromstring(document).iter("Segment")
        if (position := segment.find("DefaultTransform/Position")) is not None
    }
    assert min(places["LeftToeBase"][2], places["RightToeBase"][2]) == pytest.approx(0.0)
    assert places["LeftToeBase"][1] > places["LeftFoot"][1]
    assert places["LeftHand"][0] < places["LeftArm"][0] < 0 < places["RightArm"][0]


def test_stream_has_markers_times_and_absent_people() -> None:
    first = live_instant((1, 2))
    later = LiveInstant(first.time_s + 1 / RATE_HZ, first.people[:1], 0.0)
    with serving() as (output, base_port):
        output.send(first)
        with showing(output, lambda _: later):
            packet = streamed(base_port, ["3d", "3dres", "skeleton", "timecode"], 3)[-1]
    assert packet.timestamp == round(later.time_s * 1e6)
    assert packet.framenumber == 2
    _, markers = packet.get_3d_markers()
    np.testing.assert_allclose(np.array(markers)[: len(JOINTS)], 1e3 * first.people[0].xyz_m, atol=1e3 * TOLERANCE_M)
    assert np.isnan(np.array(markers)[len(JOINTS) :]).all()
    _, residuals = packet.get_3d_markers_residual()
    np.testing.assert_allclose(np.array(residuals)[:, :3], np.array(markers))
    assert np.isnan(np.array(residuals)[:, 3]).all()
    _, skeletons = packet.get_skeletons()
    assert [len(skeleton) for skeleton in skeletons] == [len(SKELETON) - 3, 0]
    _, ((kind, high, low),) = packet.get_timecode()
    assert (kind, (high << 32) + low) == (2, round(later.time_s * 10_000_000))


def test_people_without_skeleton_are_unlabelled_markers() -> None:
    person = LivePerson(7, live_instant([1]).people[0].xyz_m.copy(), None)
    person.xyz_m[3] = np.nan
    with serving() as (output, base_port):
        output.send(LiveInstant(1.0, (person,), 0.0))
        packet = asked(base_port, lambda connection: connection.get_current_frame(["3dnolabels", "3dnolabelsres"]))
    _, markers = packet.get_3d_markers_no_label()
    known = [joint for joint in range(len(JOINTS)) if joint != 3]
    assert [marker.id for marker in markers] == [7000 + joint for joint in known]
    np.testing.assert_allclose([marker[:3] for marker in markers], 1e3 * person.xyz_m[known], atol=1e3 * TOLERANCE_M)
    assert len(packet.get_3d_markers_no_label_residual()[1]) == len(known)


def test_labels_name_people_and_joints_in_marker_order() -> None:
    with serving() as (output, base_port):
        output.send(live_instant((3, 5)))
        document = asked(base_port, lambda connection: connection.get_parameters(["all"]))
    root = ElementTree.fromstring(document)
    assert [label.text for label in root.iter("Name")] == [f"person-{n}_{joint}" for n in (3, 5) for joint in JOINTS]
    assert root.findtext("The_3D/Labels") == str(2 * len(JOINTS))
    assert root.findtext("General/Frequency") == "50"


def test_new_people_wait_until_parameters_are_read_again() -> None:
    """A receiver that knows one person by the parameters gets one, and an event that tells it of others."""

    async def ask(connection: qtm_rt.QRTConnection) -> tuple[list[int], list[int]]:
        await connection.get_parameters(["skeleton"])
        output.send(live_instant((1, 2)))
        assert await asyncio.wait_for(events.get(), 60) == QRTEvent.EventConnected
        before = (await connection.get_current_frame(["skeleton"])).get_skeletons()[1]
        await connection.get_parameters(["skeleton"])
        after = (await connection.get_current_frame(["skeleton"])).get_skeletons()[1]
        return [len(skeleton) > 0 for skeleton in before], [len(skeleton) > 0 for skeleton in after]

    events: asyncio.Queue[QRTEvent] = asyncio.Queue()
    with serving() as (output, base_port):
        output.send(live_instant([1]))
        assert asked(base_port, ask, on_event=events.put_nowait) == ([True], [True, True])


def test_client_negotiates_version_state_and_order() -> None:
    async def ask(connection: qtm_rt.QRTConnection) -> list[bytes | QRTEvent]:
        state = await connection.get_state()
        return [state, await connection.byte_order(), await connection.qtm_version()]

    with serving() as (_, base_port):
        state, order, version = asked(base_port, ask)
        assert (state, order) == (QRTEvent.EventConnected, b"Byte order is little endian")
        assert isinstance(version, bytes)
        assert version.startswith(b"Multicap ")


@pytest.mark.parametrize(
    ("text", "answer"),
    [
        ("Version", "Version is 1.1"),
        ("Version 1.21", "Version set to 1.21"),
        ("Version 1.99", "Version must be 1.8 to 1.27"),
        ("GetParameters Skeleton", "Skeletons need version 1.21 or later"),
        ("GetParameters nonsense", "Parse error"),
        ("GetCurrentFrame 3D", "No frame yet"),
        ("GetCurrentFrame 6D", "Parse error"),
        ("StreamFrames AllFrames UDP:192.0.2.7:4000 3D", "Frames are sent to the address of the connection only"),
        ("StreamFrames AllFrames UDP:70000 3D", "Parse error"),
        ("StreamFrames often 3D", "Parse error"),
        ("ReleaseControl", "You are already a regular client"),
        ("NoSuchCommand", "Parse error"),
        ("", "Parse error"),
    ],
)
def test_commands_are_answered(text: str, answer: str) -> None:
    with serving() as (_, base_port), socket.create_connection(("127.0.0.1", base_port + 1), 60) as connection:
        assert received(connection) == (1, b"QTM RT Interface connected\0")
        connection.sendall(command(text))
        assert received(connection)[1] == answer.encode() + b"\0"


def test_parameters_that_do_not_exist_here_are_empty() -> None:
    """Receivers of rigid bodies and forces ask for these as well, and take an error for a failure."""
    with serving() as (_, base_port):
        document = asked(base_port, lambda connection: connection.get_parameters(["6d", "force"]))
    assert document == b"<QTM_Parameters_Ver_1.25></QTM_Parameters_Ver_1.25>"


def test_stream_before_first_instant_begins_later() -> None:
    with serving() as (output, base_port), showing(output, lambda number: live_instant([1], 2.0 + number / RATE_HZ)):
        assert len(streamed(base_port, ["3d"], 2)) == 2


@pytest.mark.parametrize(("frames", "step"), [("frequencydivisor:5", 5), ("frequency:10", 5)])
def test_streams_have_requested_rates(frames: str, step: int) -> None:
    with serving() as (output, base_port), showing(output, lambda number: live_instant([1], 2.0 + number / RATE_HZ)):
        numbers = [packet.framenumber for packet in streamed(base_port, ["3d"], 6, frames)]
    assert set(np.diff(numbers[1:]).tolist()) == {step}


def test_frames_go_to_udp_port_of_receiver() -> None:
    with (
        serving() as (output, base_port),
        socket.create_connection(("127.0.0.1", base_port + 1), 60) as connection,
        socket.socket(type=socket.SOCK_DGRAM) as datagrams,
    ):
        datagrams.bind(("127.0.0.1", 0))
        datagrams.settimeout(60)
        received(connection)
        # Without a zero at the end, as clients for .NET send commands.
        text = f"StreamFrames AllFrames UDP:{datagrams.getsockname()[1]} 3D Analog".encode()
        connection.sendall(HEADER.pack(HEADER.size + len(text), 1) + text)
        assert received(connection) == (4, b"")
        assert output.send(live_instant([1])) == 1
        content = datagrams.recv(65536)
    assert HEADER.unpack_from(content) == (len(content), 3)
    assert list(QRTPacket(content[8:]).components) == [QRTComponentType.Component3d]


def test_discovery_tells_base_port() -> None:
    with serving() as (_, base_port), socket.socket(type=socket.SOCK_DGRAM) as datagrams:
        datagrams.bind(("127.0.0.1", 0))
        datagrams.settimeout(60)
        for wrong in (b"", b"x" * 10, HEADER.pack(10, 1) + b"\0\1", b"\0" * 2000):
            datagrams.sendto(wrong, ("127.0.0.1", base_port + 4))
        question = HEADER.pack(10, 7) + datagrams.getsockname()[1].to_bytes(2, "big")
        datagrams.sendto(question, ("127.0.0.1", base_port + 4))
        answer = datagrams.recv(65536)
    assert HEADER.unpack_from(answer) == (len(answer), 1)
    assert int.from_bytes(answer[-2:], "big") == base_port
    assert len(answer[8:-3].decode().split(",")) == 3


@pytest.mark.parametrize(
    "garbage",
    [
        b"\xff" * 100,
        HEADER.pack(4, 1),
        HEADER.pack(2**31, 1),
        b"GET / HTTP/1.1\r\n\r\n",
        HEADER.pack(70_000, 2) + b"x" * 70_000,
    ],
    ids=["bytes", "short", "huge", "http", "long"],
)
def test_garbage_ends_its_own_connection_only(garbage: bytes) -> None:
    with (
        serving() as (output, base_port),
        socket.create_connection(("127.0.0.1", base_port + 1), 60) as hostile,
        socket.create_connection(("127.0.0.1", base_port + 1), 60) as receiver,
    ):
        received(receiver)
        with contextlib.suppress(OSError):
            hostile.sendall(garbage)
        hostile.settimeout(60)
        with contextlib.suppress(ConnectionResetError):
            while hostile.recv(4096):
                pass
        receiver.sendall(command("StreamFrames AllFrames 3D"))
        assert received(receiver)[0] == 4
        assert output.send(live_instant([1])) == 1
        assert received(receiver)[0] == 3


def test_receiver_that_never_reads_misses_frames() -> None:
    """Its waiting bytes are bounded, sending never waits, and another receiver gets every frame."""
    with (
        serving() as (output, base_port),
        socket.socket() as hanging,
        socket.create_connection(("127.0.0.1", base_port + 1), 60) as receiver,
    ):
        hanging.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        hanging.connect(("127.0.0.1", base_port + 1))
        for connection in (hanging, receiver):
            connection.sendall(command("StreamFrames AllFrames 3D Skeleton"))
        for _ in range(2):
            received(receiver)
        instant, num_sent, num_frames = live_instant(), 0, 600
        for _ in range(num_frames):
            num_sent += output.send(instant)
            assert received(receiver)[0] == 3
        waiting = [connection._transport.get_write_buffer_size() for connection in output.receivers]
    assert num_frames < num_sent < 2 * num_frames
    assert max(waiting) < 300_000


def test_requests_of_flooding_receiver_are_bounded() -> None:
    """A receiver that asks without reading is disconnected or waits; memory does not grow with its requests."""
    with (
        serving() as (output, base_port),
        socket.create_connection(("127.0.0.1", base_port + 1), 60) as flooding,
    ):
        output.send(live_instant())
        flooding.settimeout(0.2)
        with contextlib.suppress(OSError):
            for _ in range(2000):
                flooding.sendall(command("GetParameters 3D") * 50)
        waiting = [connection._transport.get_write_buffer_size() for connection in output.receivers]
        assert sum(waiting) < 400_000
        document = asked(base_port, lambda connection: connection.get_parameters(["general"]))
    assert document.startswith(b"<QTM_Parameters")


def test_hundred_idle_connections_keep_no_receiver_out() -> None:
    with serving() as (output, base_port), contextlib.ExitStack() as opened:
        for _ in range(100):
            opened.enter_context(socket.create_connection(("127.0.0.1", base_port + 1), 60))
        assert len(streamed_once(output, base_port)) > 0
        assert len(output.receivers) <= 16


def streamed_once(output: QtmOutput, base_port: int) -> list[QRTPacket]:
    with showing(output, lambda number: live_instant([1], 2.0 + number / RATE_HZ)):
        return streamed(base_port, ["3d"], 2)


def test_end_of_capture_tells_receivers() -> None:
    with serving() as (_, base_port):
        connection = socket.create_connection(("127.0.0.1", base_port + 1), 60)
        received(connection)
    with connection:
        assert received(connection) == (6, b"\x0c")
        assert connection.recv(1) == b""


def test_used_port_is_refused_and_freed() -> None:
    with serving() as (_, base_port), pytest.raises(OSError, match="use"):
        QtmOutput(OutputStart(OutputAddress("qtm", "127.0.0.1", base_port, {}), RATE_HZ, JOINTS)).__enter__()
    with QtmOutput(OutputStart(OutputAddress("qtm", "127.0.0.1", base_port, {}), RATE_HZ, JOINTS)):
        pass


def test_people_who_left_long_ago_make_room() -> None:
    with serving() as (output, base_port):
        for number in range(1, 40):
            output.send(live_instant([number], number))
        document = asked(base_port, lambda connection: connection.get_parameters(["skeleton"]))
    names = [skeleton.get("Name") for skeleton in ElementTree.fromstring(document).iter("Skeleton")]
    assert names == [f"person-{number}" for number in range(8, 40)]


def test_client_errors_are_exceptions_of_client() -> None:
    with serving() as (_, base_port), pytest.raises(QRTCommandException):
        asked(base_port, lambda connection: connection.get_current_frame(["3d"]))
