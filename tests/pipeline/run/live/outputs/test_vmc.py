"""VMC: what a real receiver of OSC gets, in Unity's axes."""

import socket
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

import numpy as np
import pytest
from pythonosc.dispatcher import Dispatcher
from pythonosc.osc_server import BlockingOSCUDPServer
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import SkeletonMotion
from pipeline.motion.skeleton.humanoid import UNITY_BONES
from pipeline.motion.skeleton.model import WHOLE_SKELETON, forward_kinematics
from pipeline.run.live.outputs.addresses import read_outputs
from pipeline.run.live.outputs.output import OutputStart
from pipeline.run.live.outputs.vmc import VmcOutput, local_offsets_m, unity_position, unity_rotation, vmc_packet
from pipeline.run.live.records import LiveInstant, LivePerson, LiveSkeleton
from tests.ports import free_port

NUM_BONES = len(WHOLE_SKELETON)
# Left-handed axes of Unity from ours, as a matrix.
UNITY_FROM_WORLD = np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


def skeleton(seed: int = 0) -> LiveSkeleton:
    rng = np.random.default_rng(seed)
    turns = Rotation.random(NUM_BONES, rng=rng).as_quat()
    lengths_m = np.array([0.0, *rng.uniform(0.1, 0.4, NUM_BONES - 1)])
    return LiveSkeleton(rng.normal(size=3), turns, lengths_m, np.zeros((NUM_BONES, 3)))


def vmc_output(port: int, options: str = "") -> VmcOutput:
    (address,) = read_outputs([f"vmc://127.0.0.1:{port}{options}"], allow_network=False)
    return VmcOutput(OutputStart(address, 25.0, ("nose",)))


def received(send: Callable[[int], object], num_messages: int) -> list[tuple[Any, ...]]:
    """Messages that a server of python-osc gets from ``send``, to which its port is given."""
    messages: list[tuple[Any, ...]] = []
    dispatcher = Dispatcher()
    dispatcher.set_default_handler(lambda address, *values: messages.append((address, *values)))
    with BlockingOSCUDPServer(("127.0.0.1", 0), dispatcher) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        send(server.server_address[1])
        deadline_s = time.monotonic() + 60
        while len(messages) < num_messages and time.monotonic() < deadline_s:
            time.sleep(0.01)
        server.shutdown()
        thread.join()
    return messages


def test_matrices_agree_with_quaternions() -> None:
    assert np.linalg.det(UNITY_FROM_WORLD) == pytest.approx(-1.0)
    turns = Rotation.random(50, rng=np.random.default_rng(1))
    expected = UNITY_FROM_WORLD @ turns.as_matrix() @ UNITY_FROM_WORLD.T
    np.testing.assert_allclose(Rotation.from_quat(unity_rotation(turns.as_quat())).as_matrix(), expected, atol=1e-12)
    points = np.random.default_rng(2).normal(size=(50, 3))
    np.testing.assert_allclose(unity_position(points), points @ UNITY_FROM_WORLD.T, atol=1e-12)


def test_rest_pose_faces_forward_with_left_side_at_left() -> None:
    left, front, up = unity_position(np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]]))
    assert (left.tolist(), front.tolist(), up.tolist()) == ([-1.0, 0.0, -0.0], [-0.0, 0.0, 1.0], [-0.0, 1.0, -0.0])


def test_receiver_gets_every_bone_of_person() -> None:
    pose = skeleton()
    instant = LiveInstant(12.25, (LivePerson(1, np.zeros((17, 3)), pose),), 0.1)

    def send(port: int) -> None:
        with vmc_output(port) as sender:
            assert sender.send(instant) == 1

    messages = received(send, 3 + len(UNITY_BONES))
    assert messages[0] == ("/VMC/Ext/OK", 1)
    assert messages[1] == ("/VMC/Ext/T", 12.25)
    assert messages[2] == ("/VMC/Ext/Root/Pos", "root", 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    bones = {message[1]: np.array(message[2:]) for message in messages[3:]}
    assert {message[0] for message in messages[3:]} == {"/VMC/Ext/Bone/Pos"}
    assert set(bones) == set(UNITY_BONES.values())
    np.testing.assert_allclose(bones["Hips"][:3], UNITY_FROM_WORLD @ pose.root_m, atol=1e-6)
    place = next(place for place, joint in enumerate(WHOLE_SKELETON) if joint.name == "LeftForeArm")
    turn = Rotation.from_quat(pose.parent_from_joint[place]).as_matrix()
    got = Rotation.from_quat(bones["LeftLowerArm"][3:]).as_matrix()
    np.testing.assert_allclose(got, UNITY_FROM_WORLD @ turn @ UNITY_FROM_WORLD.T, atol=1e-6)
    np.testing.assert_allclose(bones["LeftLowerArm"][:3], [-pose.bone_length_m[place], 0.0, 0.0], atol=1e-6)


def test_chain_of_messages_is_pose_in_mirror() -> None:
    """Joints that a receiver computes from local positions and rotations are ours in Unity's axes."""
    pose = skeleton(3)
    places = {joint.name: place for place, joint in enumerate(WHOLE_SKELETON)}
    offsets, turns = unity_position(local_offsets_m(pose)), unity_rotation(pose.parent_from_joint)
    world_m, world_turns = np.zeros((NUM_BONES, 3)), [Rotation.identity()] * NUM_BONES
    for place, joint in enumerate(WHOLE_SKELETON):
        if joint.parent is None:
            world_m[place], world_turns[place] = offsets[place], Rotation.from_quat(turns[place])
        else:
            parent = places[joint.parent]
            world_m[place] = world_m[parent] + world_turns[parent].apply(offsets[place])
            world_turns[place] = world_turns[parent] * Rotation.from_quat(turns[place])
    motion = SkeletonMotion(1, "", 0, 25.0, pose.bone_length_m, pose.root_m[None], pose.parent_from_joint[None], ())
    expected_m = forward_kinematics(motion)[0]
    np.testing.assert_allclose(world_m, expected_m @ UNITY_FROM_WORLD.T, atol=1e-9)


def test_people_without_skeleton_are_not_available() -> None:
    instant = LiveInstant(1.0, (LivePerson(1, np.zeros((17, 3)), None), LivePerson(2, np.zeros((17, 3)), None)), 0.0)

    def send(port: int) -> None:
        with vmc_output(port) as sender:
            assert sender.send(instant) == 1

    assert received(send, 2) == [("/VMC/Ext/OK", 0), ("/VMC/Ext/T", 1.0)]


def test_people_go_to_ports_in_their_order() -> None:
    """Persons 2 and 3 of three go to two ports."""
    poses = [skeleton(seed) for seed in range(3)]
    people = tuple(LivePerson(number, np.zeros((17, 3)), pose) for number, pose in enumerate(poses, 1))
    with ExitStack() as opened:
        port = free_port()
        receivers = [opened.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(2)]
        for place, receiver in enumerate(receivers):
            receiver.bind(("127.0.0.1", port + place))
            receiver.settimeout(20)
        sender = opened.enter_context(vmc_output(port, "?people=2&person=2"))
        assert sender.send(LiveInstant(1.0, people, 0.0)) == 2
        assert [receiver.recv(65_536) for receiver in receivers] == [vmc_packet(person, 1.0) for person in people[1:]]
