"""Orientation of the feet of people who lie, kneel, crawl, hang and stand on their hands."""

import numpy as np
import pytest

from pipeline.config import ReconstructionConfig
from pipeline.data.cameras import Timebase
from pipeline.joints import BODY_FEET, COCO_17, JointSet
from pipeline.simulation.acrobatics.motions import ACROBATICS
from pipeline.simulation.acrobatics.performance import acrobat_joints_at, perform_acrobatics
from pipeline.skeleton.animate import animate
from pipeline.skeleton.model import joint_pose
from tests.pipeline.skeleton.observed import observe, ring_of

RATE_HZ = 30.0


def axis_errors_deg(name: str, joints: JointSet) -> np.ndarray:
    """Angles between the fitted feet's axes and the true lines from heel to toe."""
    keys = ACROBATICS[name][0].keys
    acrobat = perform_acrobatics(keys, (0.0, 0.0), 0.4, keys[-1].time_s, np.random.default_rng(6))
    truth_m = acrobat_joints_at(acrobat, np.arange(0.0, keys[-1].time_s, 1 / RATE_HZ), BODY_FEET)
    cameras = ring_of(5)
    track, seen = observe(cameras, truth_m[:, : len(joints.names)], noise_px=1.5, seed=2)
    timebase = Timebase(0.0, RATE_HZ, len(truth_m))
    (motion,) = animate([track], [seen], cameras, timebase, joints, ReconstructionConfig()).motions
    errors = []
    for side in ("left", "right"):
        ahead = joint_pose(motion, f"{side.capitalize()}Foot")[1].apply([0.0, -1.0, 0.0])
        true = truth_m[:, BODY_FEET.index(f"{side}_big_toe")] - truth_m[:, BODY_FEET.index(f"{side}_heel")]
        cos = (ahead * true).sum(-1) / np.linalg.norm(true, axis=-1)
        errors.append(np.degrees(np.arccos(np.clip(cos, -1.0, 1.0))))
    return np.concatenate(errors)


@pytest.mark.parametrize("name", ["lying", "crawl", "handstand", "pull-up", "kneel"])
def test_feet_that_are_never_flat_keep_their_own_pitch(name: str) -> None:
    assert np.median(axis_errors_deg(name, BODY_FEET)) < 10.0


def test_without_toes_feet_of_kneeling_people_lie_on_their_insteps() -> None:
    assert np.median(axis_errors_deg("kneel", COCO_17)) < 12.0
