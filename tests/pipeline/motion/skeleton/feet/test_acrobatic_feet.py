"""Orientation of the feet of people who lie, kneel, crawl, hang and stand on their hands."""

from functools import cache

import numpy as np
import pytest

from pipeline.core.data.animation import Animation
from pipeline.core.data.cameras import Timebase
from pipeline.core.data.people import Source, Track3D
from pipeline.core.joints import BODY_FEET, COCO_17, JointSet
from pipeline.core.options.config import ReconstructionConfig
from pipeline.motion.skeleton.animate import animate
from pipeline.motion.skeleton.feet.support import FootMarks, find_support
from pipeline.motion.skeleton.model import joint_pose
from tests.acrobatics.acrobat import acrobat_joints_at, perform_acrobatics
from tests.acrobatics.motions import ACROBATICS
from tests.cases import slow_but
from tests.pipeline.motion.skeleton.observed import observe, ring_of

RATE_HZ = 30.0


@cache
def fitted(name: str, joints: JointSet) -> tuple[np.ndarray, Animation]:
    """True joints of an acrobat, with heels and toes, and the fit to detections of some joints."""
    keys = ACROBATICS[name][0].keys
    acrobat = perform_acrobatics(keys, (0.0, 0.0), 0.4, keys[-1].time_s, np.random.default_rng(6))
    truth_m = acrobat_joints_at(acrobat, np.arange(0.0, keys[-1].time_s, 1 / RATE_HZ), BODY_FEET)
    cameras = ring_of(5)
    track, seen = observe(cameras, truth_m[:, : len(joints.names)], noise_px=1.5, seed=2)
    timebase = Timebase(0.0, RATE_HZ, len(truth_m))
    return truth_m, animate([track], [seen], cameras, timebase, joints, ReconstructionConfig())


def axis_errors_deg(name: str, joints: JointSet) -> np.ndarray:
    """Angles between the fitted feet's axes and the true lines from heel to toe."""
    truth_m, animation = fitted(name, joints)
    (motion,) = animation.motions
    errors = []
    for side in ("left", "right"):
        ahead = joint_pose(motion, f"{side.capitalize()}Foot")[1].apply([0.0, -1.0, 0.0])
        true = truth_m[:, BODY_FEET.index(f"{side}_big_toe")] - truth_m[:, BODY_FEET.index(f"{side}_heel")]
        cos = (ahead * true).sum(-1) / np.linalg.norm(true, axis=-1)
        errors.append(np.degrees(np.arccos(np.clip(cos, -1.0, 1.0))))
    return np.concatenate(errors)


@pytest.mark.parametrize("name", slow_but(["kneel"], ["lying", "crawl", "handstand", "pull-up", "kneel"]))
def test_feet_that_are_never_flat_keep_their_own_pitch(name: str) -> None:
    assert np.median(axis_errors_deg(name, BODY_FEET)) < 10.0


def test_feet_without_toes_of_kneeling_people_lie_on_insteps() -> None:
    assert np.median(axis_errors_deg("kneel", COCO_17)) < 12.0


# With feet at a right angle to the shin: 38 and 67 degrees.
@pytest.mark.parametrize(("name", "limit_deg"), slow_but([("pull-up", 25.0)], [("pull-up", 25.0), ("crawl", 30.0)]))
def test_without_toes_feet_that_carry_nobody_are_relaxed(name: str, limit_deg: float) -> None:
    assert np.median(axis_errors_deg(name, COCO_17)) < limit_deg


@pytest.mark.parametrize("name", slow_but(["lying"], ["crawl", "lying", "roll"]))
def test_feet_without_toes_behind_lying_shins_are_above_floor(name: str) -> None:
    _, animation = fitted(name, COCO_17)
    (motion,), floor = animation.motions, animation.floor
    assert floor is not None
    for side in ("Left", "Right"):
        knee_m, ankle_m, end_m = (joint_pose(motion, f"{side}{part}")[0] for part in ("Leg", "Foot", "FootEnd"))
        lies = knee_m[:, 2] - ankle_m[:, 2] < 0.1
        assert lies.any()
        # Feet touch the floor smoothly.
        assert floor.height_m(end_m)[lies].min() > -0.03


def test_without_toes_feet_of_climbers_are_not_relaxed() -> None:
    """A body that rises above a foot that stays where it is stands on it, whatever the hands do."""
    rate_hz, num_frames = 30.0, 60
    rise_m = np.linspace(0.0, 0.2, num_frames)
    xyz_m = np.zeros((num_frames, len(COCO_17.names), 3))
    for part, height_m in (("hip", 1.6), ("knee", 1.2), ("shoulder", 2.1), ("wrist", 2.5)):
        xyz_m[:, COCO_17.indices((f"left_{part}", f"right_{part}")), 2] = height_m + rise_m[:, None]
    ankles_m, known = np.zeros((num_frames, 2, 3)), np.ones((num_frames, 2), bool)
    ankles_m[..., 2] = 0.8
    ankles_m[:, 1, 2] += rise_m
    shape = xyz_m.shape[:2]
    source = np.full(shape, Source.MEASURED, np.int8)
    track = Track3D(1, 0, xyz_m, np.ones(shape), source, np.ones(shape), np.full(shape, 4))
    hangs = find_support(track, COCO_17, ankles_m, known, FootMarks.none(num_frames), rate_hz).hangs[10:-10]
    assert not hangs[:, 0].any()
    assert hangs[:, 1].all()
