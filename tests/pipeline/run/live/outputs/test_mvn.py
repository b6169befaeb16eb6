"""The network stream of MVN, read by the rules of its specification."""

import socket
import struct
from typing import NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.motion.skeleton.model import INDEX, WHOLE_SKELETON
from pipeline.run.live.outputs.addresses import OutputAddress
from pipeline.run.live.outputs.mvn import MvnOutput
from pipeline.run.live.outputs.output import OutputStart
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

# Axes of a segment, which face +X in the rest pose, in the axes of a joint, which face -Y, as columns.
JOINT_FROM_SEGMENT = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
# Numbers of segments by the tables of the specification, and our joints.
BODY = {
    1: "Hips",
    2: "Spine",
    5: "Chest",
    6: "Neck",
    7: "Head",
    **{8 + place: f"Right{name}" for place, name in enumerate(("Shoulder", "Arm", "ForeArm", "Hand"))},
    **{12 + place: f"Left{name}" for place, name in enumerate(("Shoulder", "Arm", "ForeArm", "Hand"))},
    **{16 + place: f"Right{name}" for place, name in enumerate(("UpLeg", "Leg", "Foot", "FootEnd"))},
    **{20 + place: f"Left{name}" for place, name in enumerate(("UpLeg", "Leg", "Foot", "FootEnd"))},
}
HAND = {
    0: "",
    **{1 + place: f"Thumb{place + 1}" for place in range(3)},
    **{4 + 4 * number: "" for number in range(4)},
    **{
        5 + 4 * number + place: f"{finger}{place + 1}"
        for number, finger in enumerate(("Index", "Middle", "Ring", "Pinky"))
        for place in range(3)
    },
}
HANDS = {
    first + place: f"{side}Hand{joint}"
    for side, first in (("Left", 24), ("Right", 44))
    for place, joint in HAND.items()
}


class Datagram(NamedTuple):
    """Datagram of the specification: header of 24 bytes, then the content."""

    kind: str
    sample: int
    counter: int
    num_items: int
    time_ms: int
    character: int
    num_segments: int
    num_props: int
    num_fingers: int
    content: bytes


def read_datagram(data: bytes) -> Datagram:
    name, sample, counter, items, time_ms, character, segments, props, fingers, _, size = struct.unpack(
        ">6sIBBIBBBBHH", data[:24]
    )
    assert name[:4] == b"MXTP"
    assert len(data) == 24 + size
    kind = name[4:].decode()
    return Datagram(kind, sample, counter, items, time_ms, character, segments, props, fingers, data[24:])


def read_text(data: bytes) -> tuple[str, bytes]:
    size = int.from_bytes(data[:4], "big")
    return data[4 : 4 + size].decode(), data[4 + size :]


def sent(*instants: LiveInstant) -> list[Datagram]:
    """Datagrams that a receiver gets."""
    with socket.socket(type=socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(60)
        address = OutputAddress("mvn", "127.0.0.1", receiver.getsockname()[1], {})
        with MvnOutput(OutputStart(address, 50.0, JOINTS)) as output:
            num_sent = sum(output.send(instant) for instant in instants)
        return [read_datagram(receiver.recv(65_536)) for _ in range(num_sent)]


@pytest.mark.parametrize("num_joints", [NUM_BONES, len(WHOLE_SKELETON)])
def test_receiver_gets_poses_of_four_people(num_joints: int) -> None:
    """With fingers there are 40 segments more."""
    instant = live_instant(num_joints=num_joints)
    poses = [datagram for datagram in sent(instant) if datagram.kind == "02"]
    joints = BODY if num_joints == NUM_BONES else BODY | HANDS
    assert [pose.character for pose in poses] == [0, 1, 2, 3]
    for person, datagram in zip(instant.people, poses, strict=True):
        pose, world = skeleton_of(person), world_matrices(skeleton_of(person)) @ JOINT_FROM_SEGMENT
        assert (datagram.num_segments, datagram.num_props, datagram.num_fingers) == (23, 0, len(joints) - 21)
        assert datagram.num_items == len(joints) + 2
        items = list(struct.iter_unpack(">I7f", datagram.content))
        assert [item[0] for item in items] == list(range(1, datagram.num_items + 1))
        chosen = [(item, INDEX[joints[item[0]]]) for item in items if item[0] in joints]
        got_m, places = np.array([item[1:4] for item, _ in chosen]), [place for _, place in chosen]
        got = Rotation.from_quat(np.array([item[4:] for item, _ in chosen]), scalar_first=True).as_matrix()
        np.testing.assert_allclose(got_m, pose.joint_m[places], atol=TOLERANCE_M)
        assert angle_deg(got, world[places]) < TOLERANCE_DEG
        spine_m, chest_m = pose.joint_m[INDEX["Spine"]], pose.joint_m[INDEX["Chest"]]
        np.testing.assert_allclose(items[2][1:4], (2 * spine_m + chest_m) / 3, atol=TOLERANCE_M)
        np.testing.assert_allclose(items[3][1:4], (spine_m + 2 * chest_m) / 3, atol=TOLERANCE_M)


def test_rest_pose_faces_x_with_lengths_of_bones() -> None:
    person = live_instant([1]).people[0]
    first, last = (datagram for datagram in sent(LiveInstant(1.0, (person,), 0.0)) if datagram.kind == "13")
    assert (first.counter, last.counter, last.content) == (0, 0x81, bytes(8))
    origins_m, rest = {}, first.content[4:]
    for _ in range(int.from_bytes(first.content[:4], "big")):
        name, rest = read_text(rest)
        origins_m[name], rest = np.array(struct.unpack(">3f", rest[:12])), rest[12:]
    assert rest == bytes(4)
    lengths_m = skeleton_of(person).bone_length_m
    assert list(origins_m)[:8] == ["Pelvis", "L5", "L3", "T12", "T8", "Neck", "Head", "RightShoulder"]
    forearm_m = origins_m["LeftHand"] - origins_m["LeftForeArm"]
    np.testing.assert_allclose(forearm_m, [0.0, lengths_m[INDEX["LeftHand"]], 0.0], atol=1e-6)
    assert origins_m["RightToe"][0] > origins_m["RightFoot"][0]
    assert min(origin_m[2] for origin_m in origins_m.values()) == pytest.approx(0.0, abs=1e-6)


def test_names_come_first_and_then_each_second() -> None:
    """A receiver needs the name before the first pose; one that starts late waits for a second at most."""
    people = live_instant([5]).people
    datagrams = sent(*(LiveInstant(3.0 + 0.25 * step, people, 0.0) for step in range(9)))
    kinds = [datagram.kind for datagram in datagrams]
    assert kinds[:4] == ["12", "13", "13", "25"]
    assert [datagram.time_ms for datagram in datagrams if datagram.kind == "12"] == [0, 1000, 2000]
    lines = read_text(datagrams[0].content)[0].splitlines()
    assert dict(line.split(":") for line in lines) == {
        "xmid": "5",
        "name": "person-5",
        "color": "965AC8",
        "timeOffset": "0",
    }


def test_another_person_of_character_is_named_at_once() -> None:
    first, second = live_instant([1], 1.0), live_instant([2], 4.0)
    names = [read_text(datagram.content)[0] for datagram in sent(first, second) if datagram.kind == "12"]
    assert [name.splitlines()[1] for name in names] == ["name:person-1", "name:person-2"]


def test_samples_and_time_codes_follow_instants() -> None:
    datagrams = sent(live_instant([1], 90_061.5), live_instant([1], 90_061.58))
    assert [datagram.sample for datagram in datagrams if datagram.kind == "02"] == [0, 4]
    assert [datagram.time_ms for datagram in datagrams if datagram.kind == "02"] == [0, 80]
    codes = [read_text(datagram.content) for datagram in datagrams if datagram.kind == "25"]
    assert codes == [("01:01:01.500", b""), ("01:01:01.580", b"")]


def test_people_without_skeleton_are_not_sent() -> None:
    person = LivePerson(1, live_instant([1]).people[0].xyz_m, None)
    assert sent(LiveInstant(1.0, (person,), 0.0), LiveInstant(2.0, (), 0.0)) == []
