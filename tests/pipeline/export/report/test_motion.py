"""Motion of a report: positions within half a step, thinned out evenly, quality of the whole take."""

import base64

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.export.quality.views import views_of
from pipeline.export.report.motion import ABSENT, encode_positions, encode_turns, motion_of, stride_for
from pipeline.motion.body import installed
from pipeline.motion.body.joints import BODY_JOINTS
from pipeline.motion.skeleton.model import INDEX, forward_kinematics, joint_pose
from tests.pipeline.export.viewer.takes import take
from tests.pipeline.export.writers.test_bvh import walk
from tests.pipeline.motion.skeleton.synthetic_tracks import track_of, walker


def test_positions_are_within_half_a_millimetre_and_unknown_ones_absent() -> None:
    one_m, other_m = walker(4), walker(7) + 3.0
    one_m[1, 2] = np.nan
    step_m, origin_m, content = encode_positions([one_m, other_m])
    assert step_m == 1e-3
    values = np.frombuffer(content, "<i2").reshape(11, -1, 3)
    assert (values[1, 2] == ABSENT).all()
    found_m = np.where(values == ABSENT, np.nan, origin_m + step_m * values)
    np.testing.assert_allclose(found_m, np.concatenate([one_m, other_m]), atol=0.5001e-3)


def test_far_positions_get_larger_steps() -> None:
    far_m = np.array([[[0.0, 0.0, 0.0], [131.0, 0.0, 0.0]]])
    step_m, origin_m, content = encode_positions([far_m])
    assert step_m == pytest.approx(65.5 / 32767)
    found_m = origin_m + step_m * np.frombuffer(content, "<i2").reshape(1, 2, 3)
    np.testing.assert_allclose(found_m, far_m, atol=step_m / 2 + 1e-9)


def test_nobody_is_encoded_too() -> None:
    some = take(num_frames=10)
    motion = motion_of(some, views_of(some))
    assert motion.document["people"] == []
    assert motion.num_people.tolist() == [0] * 10
    assert np.isnan(motion.error_px).all()


def test_a_long_take_is_thinned_out_evenly() -> None:
    people = take(track_of(walker(60), 1, 7), track_of(walker(30) + 1.0, 2, 50))
    num_bones = motion_of(people, views_of(people)).document["num_joints"]
    thin = motion_of(people, views_of(people), max_bytes=30 * 6 * num_bones)
    assert (thin.stride, motion_of(people, views_of(people)).stride) == (3, 1)
    first, second = thin.document["people"]
    # Frames 9, 12, ... of the first person, 51, 54, ... of the second.
    assert (first["start"], first["count"], second["start"], second["count"]) == (3, 20, 17, 10)
    content = base64.b64decode(thin.document["positions"])
    values = np.frombuffer(content, "<i2").reshape(30, num_bones, 3)
    found_m = thin.document["origin_m"] + thin.document["step_m"] * values
    expected_m = [forward_kinematics(motion) for motion in people.motions]
    np.testing.assert_allclose(found_m, np.concatenate([expected_m[0][2::3], expected_m[1][1::3]]), atol=0.6e-3)
    # The quality is that of all frames.
    assert thin.num_people.tolist() == [0] * 7 + [1] * 43 + [2] * 17 + [1] * 13 + [0] * 20


def test_turns_of_joints_bend_bodies() -> None:
    installed.install()
    people = take(track_of(walker(60), 1, 7), track_of(walker(30) + 1.0, 2, 50))
    num_bones = motion_of(people, views_of(people)).document["num_joints"]
    thin = motion_of(people, views_of(people), max_bytes=30 * 10 * num_bones, shapes=installed.load())
    assert thin.stride == 3
    assert thin.document["body"]["joints"][:num_bones] == BODY_JOINTS[:num_bones]
    for person, motion, first in zip(thin.document["people"], people.motions, (2, 1), strict=True):
        steps = np.frombuffer(base64.b64decode(person["body"]["turns"]), "i1").reshape(-1, num_bones, 4)
        assert len(steps) == person["count"]
        for joint in ("Hips", "LeftForeArm", "RightFoot"):
            _, expected = joint_pose(motion, joint)
            found = Rotation.from_quat(steps[:, INDEX[joint]] / 127.0)
            assert np.degrees((expected[first::3].inv() * found).magnitude()).max() < 1.0


def test_fingers_that_a_person_has_not_have_no_turn() -> None:
    steps = np.frombuffer(base64.b64decode(encode_turns(walk(4), range(1, 4), 64)), "i1").reshape(3, 64, 4)
    assert (np.abs(np.linalg.norm(steps[:, :24] / 127.0, axis=-1) - 1.0) < 0.02).all()
    assert not steps[:, 24:].any()


@pytest.mark.parametrize("num_frames", [[1], [1, 1, 1], [10, 3], [100_000, 7]])
def test_a_stride_is_found_for_every_take(num_frames: list[int]) -> None:
    stride = stride_for(num_frames, 100, 1000)
    assert sum(-(-num // stride) for num in num_frames) <= max(10, len(num_frames))
