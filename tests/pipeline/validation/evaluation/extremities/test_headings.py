"""Directions of exported feet: spread around the median, outwards alike on both sides."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import SkeletonMotion
from pipeline.core.data.cameras import Timebase
from pipeline.motion.skeleton.model import INDEX, SKELETON, joint_pose
from pipeline.validation.evaluation.extremities.feet import score_foot_directions

NUM_FRAMES = 40
TIMEBASE = Timebase(0.0, 25.0, NUM_FRAMES)


def standing(outwards_deg: np.ndarray, x_m: float = 0.0, start_frame: int = 0) -> SkeletonMotion:
    """A person in the rest pose whose feet are turned outwards."""
    parent_from_joint = np.tile([0.0, 0.0, 0.0, 1.0], (len(outwards_deg), len(SKELETON), 1))
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        turn = Rotation.from_euler("z", sign * outwards_deg[:, None], degrees=True)
        parent_from_joint[:, INDEX[f"{side}Foot"]] = turn.as_quat()
    length_m = 1.7 * np.array([joint.stature_share for joint in SKELETON])
    root_m = np.tile([x_m, 0.0, 1.0], (len(outwards_deg), 1))
    return SkeletonMotion(1, "person-1", start_frame, 25.0, length_m, root_m, parent_from_joint, ())


def feet_m(motion: SkeletonMotion) -> np.ndarray:
    return np.stack(
        [
            np.stack([joint_pose(motion, f"{side}{end}")[0] for end in ("Foot", "FootEnd")], axis=1)
            for side in ("Left", "Right")
        ],
        axis=1,
    )


TRUTH_M = np.stack([feet_m(standing(np.zeros(NUM_FRAMES), x_m)) for x_m in (5.0, 0.0)])


def test_a_constant_difference_is_definition() -> None:
    scores = score_foot_directions(
        [standing(np.full(NUM_FRAMES, 8.0))], TIMEBASE, np.arange(NUM_FRAMES) / 25.0, TRUTH_M
    )
    assert scores["foot_heading_spread_deg"] == pytest.approx(0.0, abs=1e-6)
    assert scores["foot_pitch_spread_90_deg"] == pytest.approx(0.0, abs=1e-6)


def test_the_spread_is_that_around_the_median() -> None:
    outwards_deg = np.tile([-6.0, -4.0, 0.0, 4.0, 6.0], NUM_FRAMES // 5)
    motions = [standing(outwards_deg[10:], 0.02, 10), standing(outwards_deg, 5.02)]
    scores = score_foot_directions(motions, TIMEBASE, np.arange(NUM_FRAMES) / 25.0, TRUTH_M)
    assert scores["foot_heading_spread_deg"] == pytest.approx(4.0)
    assert scores["foot_heading_spread_90_deg"] == pytest.approx(6.0)


def test_without_motions_there_are_no_figures() -> None:
    scores = score_foot_directions([], TIMEBASE, np.arange(NUM_FRAMES) / 25.0, TRUTH_M)
    assert set(scores.values()) == {None}
