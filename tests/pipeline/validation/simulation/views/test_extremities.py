"""Simulated detection of feet and hands: rates of faults, and feet and hands that follow their limbs."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.core.data.cameras import Camera
from pipeline.core.data.detections import Detections
from pipeline.core.joints import WHOLE_BODY, finger_joints
from pipeline.geometry.camera import project
from pipeline.validation.simulation.motion.performance import joints_at, perform
from pipeline.validation.simulation.motion.script import Gesture, Role, Stay
from pipeline.validation.simulation.rigs import Layout, Rig, build_cameras
from pipeline.validation.simulation.views.detector import PERFECT, DetectorAccuracy
from pipeline.validation.simulation.views.extremities import detect_extremities
from pipeline.validation.simulation.views.faults import NO_FAULTS
from pipeline.validation.simulation.views.occlusion import Box

NUM_FRAMES = 2000
LEFT, RIGHT = (WHOLE_BODY.indices(finger_joints(side)) for side in ("left", "right"))
HANDS = [*LEFT, *RIGHT]
FEET = WHOLE_BODY.indices(("left_heel", "right_heel", "left_big_toe", "right_big_toe"))


def camera() -> Camera:
    return build_cameras(Rig(Layout.RING, 4, (5.0, 5.0), 2.0), np.random.default_rng(4))[0]


def people() -> np.ndarray:
    """World positions of two people side by side whose hands are in front of their chests, towards the camera."""
    towards = float(np.arctan2(*np.flip(-camera().cam_from_world.inverse().translation_m[:2]))) + np.pi
    roles = [Role(place, towards, (Stay(20.0, Gesture.HANDS),)) for place in ((-1.0, 1.0), (1.0, -1.0))]
    performed = [perform(role, 20.0, np.random.default_rng(k), WHOLE_BODY) for k, role in enumerate(roles)]
    return np.stack([joints_at(person, np.linspace(1.0, 19.0, NUM_FRAMES)) for person in performed])


PEOPLE_M = people()


def run(detector: DetectorAccuracy, boxes: tuple[Box, ...] = ()) -> tuple[Detections, np.ndarray]:
    return detect_extremities(camera(), 0.04, PEOPLE_M, boxes, detector, np.random.default_rng(1), WHOLE_BODY)


def with_faults(**rates: float) -> DetectorAccuracy:
    return replace(PERFECT, faults=replace(NO_FAULTS, **rates))


def expected_px(detections: Detections, identity: np.ndarray) -> np.ndarray:
    return project(camera(), PEOPLE_M)[identity, detections.frame]


def test_noise_in_pixels_is_as_given() -> None:
    detections, identity = run(replace(PERFECT, noise_px=2.0))
    error_px = np.where(
        detections.score[..., None] > 0.45, detections.keypoints_px - expected_px(detections, identity), np.nan
    )
    for joints in (HANDS, FEET):
        assert np.nanstd(error_px[:, joints]) == pytest.approx(2.0, rel=0.1)


def test_noise_of_fingers_is_smaller_than_that_of_feet() -> None:
    detections, identity = run(replace(PERFECT, noise_m=0.02))
    error_px = np.where(
        detections.score[..., None] > 0.45, detections.keypoints_px - expected_px(detections, identity), np.nan
    )
    assert np.nanstd(error_px[:, HANDS]) == pytest.approx(0.5 * np.nanstd(error_px[:, FEET]), rel=0.15)


def test_hands_are_missed_as_whole() -> None:
    detections, _ = run(with_faults(miss_hand=0.3))
    found = detections.score > 0
    for hand in (LEFT, RIGHT):
        assert (found[:, hand].all(1) | ~found[:, hand].any(1)).all()
        assert found[:, hand[0]].mean() == pytest.approx(0.7, abs=0.06)
    assert found[:, FEET].all()
    assert np.isnan(detections.keypoints_px[~found]).all()


def test_small_hands_are_not_found() -> None:
    # A palm is some 9 cm long and some 5 m away: 15 px at this focal length.
    for smallest_px, share in ((8.0, 1.0), (25.0, 0.0)):
        detections, _ = run(replace(PERFECT, smallest_palm_px=smallest_px))
        assert (detections.score[:, HANDS] > 0).mean() == share
        assert (detections.score[:, FEET] > 0).all()


def test_left_and_right_hands_are_exchanged() -> None:
    detections, identity = run(with_faults(swap_hands=0.2))
    true_px = expected_px(detections, identity)
    own = np.isclose(detections.keypoints_px[:, LEFT], true_px[:, LEFT]).all((1, 2))
    other = np.isclose(detections.keypoints_px[:, LEFT], true_px[:, RIGHT]).all((1, 2))
    assert (own ^ other).all()
    assert other.mean() == pytest.approx(0.2, abs=0.05)
    np.testing.assert_allclose(detections.keypoints_px[:, FEET], true_px[:, FEET], atol=1e-9)


def test_feet_and_hands_follow_swapped_limbs() -> None:
    detections, identity = run(with_faults(swap=0.5))
    true_px = expected_px(detections, identity)
    share = []
    for limb, beyond in (("wrist", "index_tip"), ("ankle", "heel")):
        left, right, left_end, right_end = WHOLE_BODY.indices(
            tuple(f"{side}_{joint}" for joint in (limb, beyond) for side in ("left", "right"))
        )
        is_swapped = np.isclose(detections.keypoints_px[:, left], true_px[:, right]).all(1)
        share.append(is_swapped.mean())
        end_px = np.where(is_swapped[:, None], true_px[:, right_end], true_px[:, left_end])
        np.testing.assert_allclose(detections.keypoints_px[:, left_end], end_px, atol=1e-9)
    # Each person swaps arms, legs or both.
    assert sum(share) > 0.4


def test_hands_behind_box_are_lost_and_feet_below_it_are_not() -> None:
    # The camera looks along X from 4.6 m, at a height of 2 m; knees and feet are visible below the box.
    box = Box((1.0, -0.6, 1.0), (1.1, 1.6, 2.5))
    person_m = PEOPLE_M[:1] - np.array([-1.0, 1.0, 0.0])
    detector = replace(PERFECT, hidden_missing=1.0)
    detections, _ = detect_extremities(camera(), 0.04, person_m, (box,), detector, np.random.default_rng(1), WHOLE_BODY)
    assert len(detections.frame) == NUM_FRAMES
    assert (detections.score[:, HANDS] > 0).mean() < 0.1
    assert (detections.score[:, FEET] > 0).mean() > 0.9
