"""Cameras that are moved in the middle of a take."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.calibration.adjustment.parameters import move_camera
from pipeline.calibration.refinement.bumps import find_steps
from pipeline.calibration.refinement.refine_cameras import refine
from pipeline.calibration.refinement.sightings import JointSightings
from tests.pipeline.calibration.refinement.people import disturb, ring, see, walk

CAMERAS = ring(4)
STEP = np.array([0.0, np.radians(1.5), 0.0, 0.0, 0.0, 0.0, 0.0])


def bumped(camera: int, bump_s: float, num_cameras: int = 4) -> JointSightings:
    time_s, points_m = walk(20.0)
    before = CAMERAS[:num_cameras]
    after = tuple(move_camera(one, STEP) if k == camera else one for k, one in enumerate(before))
    early, late = see(before, time_s, points_m), see(after, time_s, points_m)
    is_late = (time_s >= bump_s)[:, None, None]
    return replace(early, points_px=np.where(is_late, late.points_px, early.points_px))


@pytest.mark.slow
@pytest.mark.parametrize(("camera", "bump_s"), [(2, 14.0), (0, 6.0)])
def test_bumped_camera_is_found_and_longer_part_sets_pose(camera: int, bump_s: float) -> None:
    rng = np.random.default_rng(camera)
    given = tuple(disturb(one, rng, 0.5, 0.01) for one in CAMERAS)
    found = refine(given, given, bumped(camera, bump_s))
    (step,) = found.steps
    assert step.camera == camera
    assert step.time_s == pytest.approx(bump_s, abs=0.41)
    assert np.degrees(step.turn_rad) == pytest.approx(1.5, abs=0.2)


def test_no_bump_is_found_in_quiet_take() -> None:
    assert find_steps(CAMERAS, see(CAMERAS, *walk(20.0))) == []
    assert find_steps(CAMERAS[:2], bumped(0, 10.0, num_cameras=2)) == []
