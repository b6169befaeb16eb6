"""The JSON stream of Rokoko, read as its public receivers read it."""

import json
import socket
from typing import Any

import lz4.frame
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.motion.skeleton.model import INDEX, WHOLE_SKELETON
from pipeline.run.live.outputs.addresses import OutputAddress
from pipeline.run.live.outputs.output import OutputStart
from pipeline.run.live.outputs.rokoko import RokokoOutput
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

# Left-handed axes of Unity from ours, as a matrix.
UNITY_FROM_WORLD = np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
# Rotations (x, y, z, w) in the reference pose of the receiver for Unity, rounded there to three places.
REFERENCE = {
    "hip": ("Hips", (0, 0, 0, 1)),
    "chest": ("Chest", (0, 0, 1, 0)),
    "head": ("Head", (0, 0, 1, 0)),
    "leftShoulder": ("LeftShoulder", (0, 0, 0.707, -0.707)),
    "rightShoulder": ("RightShoulder", (0, 0, 0.707, 0.707)),
    "leftLowerArm": ("LeftForeArm", (-0.5, -0.5, 0.5, -0.5)),
    "rightHand": ("RightHand", (0.5, -0.5, 0.5, 0.5)),
    "leftUpLeg": ("LeftUpLeg", (0, 0.707, 0, 0.707)),
    "rightLeg": ("RightLeg", (0, -0.707, 0, 0.707)),
    "leftFoot": ("LeftFoot", (0, 0.707, -0.707, 0)),
    "rightToe": ("RightFootEnd", (0, -0.707, 0.707, 0)),
}
FINGERS = {
    "leftThumbProximal": ("LeftHandThumb1", (-0.561, -0.701, 0.430, -0.092)),
    "rightThumbMedial": ("RightHandThumb2", (0.653, -0.653, 0.271, 0.271)),
    "leftIndexDistal": ("LeftHandIndex3", (-0.5, -0.5, 0.5, -0.5)),
    "rightLittleTip": ("RightHandPinky3End", (0.5, -0.5, 0.5, 0.5)),
}


def sent(*instants: LiveInstant) -> list[Any]:
    """Frames that a receiver gets; the receivers need the size in the head of each."""
    with socket.socket(type=socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(60)
        address = OutputAddress("rokoko", "127.0.0.1", receiver.getsockname()[1], {})
        with RokokoOutput(OutputStart(address, 50.0, JOINTS)) as output:
            packets = [receiver.recv(81_920) for instant in instants for _ in range(output.send(instant))]
    for packet in packets:
        assert lz4.frame.get_frame_info(packet)["content_size"] == len(lz4.frame.decompress(packet))
        assert len(packet) < 32_768
    return [json.loads(lz4.frame.decompress(packet)) for packet in packets]


def vector(values: dict[str, float], axes: str) -> list[float]:
    return [values[axis] for axis in axes]


@pytest.mark.parametrize("num_joints", [NUM_BONES, len(WHOLE_SKELETON)])
def test_receiver_gets_bones_of_four_people(num_joints: int) -> None:
    """With fingers there are 40 bones more, and the frame still fits into the smallest receiver."""
    instant = live_instant(num_joints=num_joints)
    (frame,) = sent(instant)
    assert (frame["version"], frame["fps"], frame["scene"]["props"]) == (3.0, 50, [])
    assert [actor["name"] for actor in frame["scene"]["actors"]] == [f"person-{number}" for number in (1, 2, 3, 4)]
    bones = REFERENCE if num_joints == NUM_BONES else REFERENCE | FINGERS
    for person, actor in zip(instant.people, frame["scene"]["actors"], strict=True):
        pose = skeleton_of(person)
        assert len(actor["body"]) == (23 if num_joints == NUM_BONES else 63)
        assert actor["meta"]["hasGloves"] == (num_joints > NUM_BONES)
        places = [INDEX[joint] for joint, _ in bones.values()]
        got_m = np.array([vector(actor["body"][bone]["position"], "xyz") for bone in bones])
        np.testing.assert_allclose(got_m, pose.joint_m[places] @ UNITY_FROM_WORLD.T, atol=TOLERANCE_M)
        got = Rotation.from_quat([vector(actor["body"][bone]["rotation"], "xyzw") for bone in bones])
        reference = Rotation.from_quat([turn for _, turn in bones.values()])
        # A receiver turns its model's bones by this from their pose in the T-pose.
        turned = (got * reference.inv()).as_matrix()
        expected = UNITY_FROM_WORLD @ world_matrices(pose)[places] @ UNITY_FROM_WORLD.T
        assert angle_deg(turned[: len(REFERENCE)], expected[: len(REFERENCE)]) < TOLERANCE_DEG
        # Reference rotations of thumbs are rounded to three places.
        assert angle_deg(turned, expected) < 0.15


def test_dimensions_are_of_rest_pose() -> None:
    (frame,) = sent(live_instant([3]))
    (actor,) = frame["scene"]["actors"]
    assert actor["color"] == [80, 180, 90]
    lengths_m = skeleton_of(live_instant([3]).people[0]).bone_length_m
    trunk_m = sum(lengths_m[INDEX[name]] for name in ("Spine", "Chest", "Neck", "Head", "HeadEnd"))
    dimensions = actor["dimensions"]
    assert dimensions["totalHeight"] - dimensions["hipHeight"] == pytest.approx(trunk_m, abs=1e-4)
    assert dimensions["hipHeight"] > lengths_m[INDEX["LeftLeg"]]


def test_time_counts_from_first_frame() -> None:
    """Receivers keep it with single precision."""
    frames = sent(live_instant([1], 1.8e9), live_instant([1], 1.8e9 + 0.02))
    assert [frame["scene"]["timestamp"] for frame in frames] == pytest.approx([0.0, 0.02], abs=1e-6)


def test_frame_without_people_follows_the_last_one() -> None:
    """A person who is out of sight keeps the last pose for two seconds."""
    person = LivePerson(2, live_instant([1]).people[0].xyz_m, None)
    gone = [LiveInstant(time_s, (), 0.0) for time_s in (1.0, 13.0, 15.0, 16.0)]
    frames = sent(gone[0], live_instant([1], 12.25), gone[1], gone[2], LiveInstant(15.5, (person,), 0.0), gone[3])
    assert [len(frame["scene"]["actors"]) for frame in frames] == [1, 1, 0]
    bones = [frame["scene"]["actors"][0]["body"] for frame in frames[:2]]
    assert bones[0] == bones[1]
