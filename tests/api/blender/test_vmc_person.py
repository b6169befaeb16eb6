"""A person of VMC messages is the one that was sent; packets of OSC are read as another library writes them."""

import struct

import numpy as np
import pytest
from pythonosc.osc_bundle import OscBundle
from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder
from pythonosc.osc_message import OscMessage
from pythonosc.osc_message_builder import OscMessageBuilder
from scipy.spatial.transform import Rotation

from api.blender.extension.vmc_person import VmcPerson, is_same_person, read_messages
from pipeline.core.data.animation import SkeletonMotion
from pipeline.motion.skeleton.humanoid import UNITY_BONES
from pipeline.motion.skeleton.model import INDEX, SKELETON, WHOLE_SKELETON, forward_kinematics
from pipeline.run.live.outputs.vmc import vmc_packet
from pipeline.run.live.records import LivePerson, LiveSkeleton

NUM_BONES = len(WHOLE_SKELETON)


def sent(seed: int, scale: float = 1.0, num_bones: int = NUM_BONES) -> LiveSkeleton:
    """Skeleton of a person in a random pose."""
    rng = np.random.default_rng(seed)
    turns = Rotation.from_rotvec(rng.normal(0.0, 0.6, (NUM_BONES, 3))).as_quat()
    lengths_m = scale * np.array([1.7 * joint.stature_share for joint in WHOLE_SKELETON])
    return LiveSkeleton(rng.normal(size=3), turns[:num_bones], lengths_m[:num_bones], np.zeros((num_bones, 3)))


def packet(skeleton: LiveSkeleton | None) -> bytes:
    return vmc_packet(LivePerson(1, np.zeros((17, 3)), skeleton), 1.0)


def bone_packet(bone: str, *numbers: float) -> bytes:
    message = OscMessageBuilder("/VMC/Ext/Bone/Pos")
    message.add_arg(bone)
    for number in numbers:
        message.add_arg(number)
    bundle = OscBundleBuilder(IMMEDIATELY)
    bundle.add_content(message.build())
    return bundle.build().dgram


def joints_m(person: VmcPerson) -> dict[str, np.ndarray]:
    """World positions of the joints, from the rotations and the offsets at rest."""
    rest, (local, root_m) = person.rest(), person.pose()
    places_m: dict[str, np.ndarray] = {}
    turns: dict[str, Rotation] = {}
    for joint, parent in rest.parents.items():
        own = Rotation.from_quat(local.get(joint, (1.0, 0.0, 0.0, 0.0)), scalar_first=True)
        turns[joint] = own if parent is None else turns[parent] * own
        places_m[joint] = np.array(root_m)
        if parent is not None:
            places_m[joint] = places_m[parent] + turns[parent].apply(rest.offsets_m[joint])
    return places_m


def test_joints_are_where_they_were_sent() -> None:
    person, skeleton = VmcPerson(), sent(3)
    assert not person.is_complete
    assert person.take(packet(None))
    assert not person.is_new
    assert person.take(packet(skeleton))
    assert person.is_complete
    assert person.is_new
    motion = SkeletonMotion(
        1, "", 0, 25.0, skeleton.bone_length_m, skeleton.root_m[None], skeleton.parent_from_joint[None], ()
    )
    expected_m, found_m = forward_kinematics(motion)[0], joints_m(person)
    for joint in UNITY_BONES:
        np.testing.assert_allclose(found_m[joint], expected_m[INDEX[joint]], atol=1e-5)
    assert not person.is_new


def test_rest_pose_stands_on_floor() -> None:
    person = VmcPerson()
    person.take(packet(sent(1)))
    offsets_m = person.rest().offsets_m
    ankle_m = offsets_m["Hips"][2] + sum(offsets_m[f"Left{joint}"][2] for joint in ("UpLeg", "Leg", "Foot"))
    assert ankle_m == pytest.approx(0.039 * 1.7, abs=0.01)
    assert offsets_m["LeftArm"][0] > 0.1
    assert offsets_m["LeftLeg"][2] < -0.3


def test_sender_without_fingers_moves_none() -> None:
    body = VmcPerson()
    body.take(packet(sent(1, num_bones=len(SKELETON))))
    assert not [joint for joint in body.rest().parents if "Index" in joint]
    person = VmcPerson()
    person.take(packet(sent(1)))
    assert person.rest().parents["RightHandPinky1"] == "RightHand"
    assert not is_same_person(body.rest(), person.rest())


def test_finger_without_base_moves_nothing() -> None:
    """Each joint of the rest pose has its parent there, whichever bones a sender has."""
    person = VmcPerson()
    person.take(packet(sent(1, num_bones=len(SKELETON))))
    person.take(bone_packet("LeftIndexIntermediate", 0.0, 0.0, 0.02, 0.0, 0.0, 0.0, 1.0))
    rest = person.rest()
    assert "LeftHandIndex2" not in rest.parents
    assert {parent for parent in rest.parents.values() if parent is not None} <= rest.parents.keys()


def test_another_person_has_other_bones() -> None:
    first, second, third = VmcPerson(), VmcPerson(), VmcPerson()
    for person, skeleton in ((first, sent(1)), (second, sent(2)), (third, sent(1, 1.1))):
        person.take(packet(skeleton))
    assert is_same_person(first.rest(), second.rest())
    assert not is_same_person(first.rest(), third.rest())


def test_extra_bone_turns_bones_above_it() -> None:
    person = VmcPerson()
    person.take(packet(sent(1)))
    before = joints_m(person)
    half = np.sqrt(0.5)
    person.take(bone_packet("UpperChest", 0.0, 0.1, 0.0, 0.0, half, 0.0, half))
    after = joints_m(person)
    np.testing.assert_allclose(after["Chest"], before["Chest"])
    assert np.linalg.norm(after["LeftForeArm"] - before["LeftForeArm"]) > 0.1
    assert person.rest().offsets_m["UpperChest"] == pytest.approx((0.0, 0.0, 0.1), abs=1e-6)


@pytest.mark.parametrize(
    "content",
    [
        bone_packet("Hips", np.nan, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0),
        bone_packet("Hips", np.inf, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0),
        bone_packet("Hips", 1e30, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0),
        bone_packet("Hips", 0.0),
        bone_packet("Tail", 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0),
    ],
)
def test_wrong_messages_move_nobody(content: bytes) -> None:
    person = VmcPerson()
    assert person.take(content)
    assert not person.is_new


def test_stranger_packet_is_recognised() -> None:
    assert not VmcPerson().take(b"GET / HTTP/1.1\r\n\r\n")


def test_whole_numbers_and_arrays_are_numbers() -> None:
    """Whole numbers of a position come in an array, and the bundle continues behind it."""
    bundle = OscBundleBuilder(IMMEDIATELY)
    for address, values in (("/other", [[1, 2.5], "x"]), ("/VMC/Ext/Bone/Pos", ["Hips", [1, 2, 3], 0, 0, 0, 1])):
        message = OscMessageBuilder(address)
        for value in values:
            message.add_arg(value)  # type: ignore[arg-type]
        bundle.add_content(message.build())
    content = bundle.build().dgram
    assert next(read_messages(content)) == ("/other", (1, 2.5, "x"))
    person = VmcPerson()
    person.take(packet(sent(1)))
    assert person.take(content)
    turns, root_m = person.pose()
    assert (turns["Hips"], root_m) == ((1.0, 0.0, 0.0, 0.0), (-1.0, -3.0, 2.0))


VALUES = [7, 0.25, "Hips", b"12345", True, False, None, "", 2.0]


def osc_packet(depth: int) -> bytes:
    """Packet of python-osc: a message, in so many bundles with a second one in each."""
    message = OscMessageBuilder("/VMC/Ext/Bone/Pos")
    for value in VALUES:
        message.add_arg(value)  # type: ignore[arg-type]
    content: OscMessage | OscBundle = message.build()
    for _ in range(depth):
        bundle = OscBundleBuilder(IMMEDIATELY)
        bundle.add_content(content)
        bundle.add_content(OscMessageBuilder("/VMC/Ext/OK").build())
        content = bundle.build()
    return content.dgram


@pytest.mark.parametrize("depth", [0, 1, 4])
def test_messages_are_those_of_another_library(depth: int) -> None:
    first, *others = read_messages(osc_packet(depth))
    assert first == ("/VMC/Ext/Bone/Pos", tuple(VALUES))
    assert others == [("/VMC/Ext/OK", ())] * depth


WRONG = {
    "empty": b"",
    "too deep": osc_packet(5),
    "no zero": b"/VMC",
    "no address": b"VMC\0,\0\0\0",
    "no tags": b"/VM\0f\0\0\0\0\0\0\0",
    "unknown tag": b"/VM\0,q\0\0",
    "number cut": b"/VM\0,f\0\0\0\0",
    "blob of minus 1": b"/VM\0,b\0\0\xff\xff\xff\xff",
    "blob too long": b"/VM\0,b\0\0\x00\x00\x01\x00",
    "no UTF-8": b"/\xff\xfe\0,\0\0\0",
    "many values": b"/VM\0," + b"T" * 200 + bytes(7),
    "bundle cut": b"#bundle\0" + bytes(8) + struct.pack(">i", 2**31 - 1),
}


@pytest.mark.parametrize("name", WRONG)
def test_malformed_osc_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match=r".*"):
        list(read_messages(WRONG[name]))


def test_any_bytes_are_refused_or_read() -> None:
    rng, right = np.random.default_rng(0), osc_packet(2)
    for _ in range(3000):
        changed = bytearray(right)
        for place in rng.integers(0, len(changed), 3).tolist():
            changed[place] = int(rng.integers(0, 256))
        try:
            list(read_messages(bytes(changed[: rng.integers(0, len(changed) + 1)])))
        except ValueError:
            continue
