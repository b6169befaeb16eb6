"""Time of a laboratory's file by feet and force, of simulated people on simulated plates."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from pipeline.core.data.animation import Animation
from pipeline.core.data.cameras import Timebase
from pipeline.core.data.laboratory import Laboratory, LaboratoryStart
from pipeline.core.data.reconstruction import Subject
from pipeline.core.data.rigid import Rigid3
from pipeline.core.joints import COCO_17
from pipeline.core.options.config import ReconstructionConfig
from pipeline.motion.laboratory.alignment import in_world_of, placed_in_time
from pipeline.motion.skeleton.animate import animate
from pipeline.motion.skeleton.corrections.poses import rows_of
from pipeline.motion.skeleton.corrections.stances import clipped
from pipeline.validation.simulation.motion.performance import joints_at
from pipeline.validation.simulation.motion.script import Gesture
from tests.pipeline.motion.gait.walks import Act, body_only, exercise, performed, walk
from tests.pipeline.motion.laboratory.simulated_plates import MASS_KG, plates_m, simulated
from tests.pipeline.motion.skeleton.observed import observe, ring_of

LEAD_S = 0.4321
ROW = ((-0.6, 0.06), (0.0, 0.0), (0.6, -0.06))
STANDING = ((0.2, 0.0),)


@cache
def animated(act: Act) -> Animation:
    cameras = ring_of(act.num_cameras)
    xyz_m = joints_at(performed(act), np.arange(0.0, act.duration_s, 1.0 / act.rate_hz))
    track, seen = observe(cameras, xyz_m, noise_px=act.noise_px, seed=act.seed)
    timebase = Timebase(0.0, act.rate_hz, len(xyz_m))
    return animate([track], [seen], cameras, timebase, act.joints, ReconstructionConfig())


def placed(act: Act, laboratory: Laboratory, start_s: float = 0.0) -> Laboratory:
    animation = animated(act)
    timebase = Timebase(start_s, act.rate_hz, animation.tracks[0].num_frames)
    return placed_in_time(laboratory, animation, act.joints, timebase, Subject())


@pytest.mark.parametrize(
    ("act", "middles_m"),
    [
        pytest.param(walk(1.2, num_cameras=4, rate_hz=30.0), ROW, id="walk"),
        pytest.param(exercise(Gesture.JUMP, num_cameras=4), STANDING, id="jump"),
        pytest.param(exercise(Gesture.SQUAT, num_cameras=4), STANDING, id="squat", marks=pytest.mark.accuracy),
        pytest.param(
            exercise(Gesture.COUNTERMOVEMENT_JUMP, num_cameras=4), STANDING, id="cmj", marks=pytest.mark.accuracy
        ),
    ],
)
def test_start_by_force_is_within_2_ms(act: Act, middles_m: tuple[tuple[float, float], ...]) -> None:
    laboratory = placed(act, simulated(act, LEAD_S, 6.0, plates_m(act, middles_m)))
    assert laboratory.start is not None
    assert laboratory.check is not None
    error_s = abs(laboratory.start.time_s - LEAD_S)
    assert error_s < 0.002
    assert error_s < 3.0 * laboratory.start.sigma_s < 0.01
    assert laboratory.check.mass_kg == pytest.approx(MASS_KG, rel=0.01)
    assert laboratory.check.apart_m is not None
    assert 0.02 < laboratory.check.apart_m < 0.2


def start_of_walk(seed: int, rate_hz: float, middles_m: tuple[tuple[float, float], ...]) -> LaboratoryStart | None:
    act = replace(walk(1.2, num_cameras=4, rate_hz=rate_hz), seed=seed)
    return placed(act, simulated(act, LEAD_S, 6.0, plates_m(act, middles_m))).start


@pytest.mark.accuracy
@pytest.mark.parametrize("rate_hz", [30.0, 50.0, 60.0])
def test_start_of_walk_is_within_its_deviation(rate_hz: float) -> None:
    """Walks of 20 people over three plates; ``-s`` prints the errors."""
    starts = [start_of_walk(seed, rate_hz, ROW) for seed in range(20, 40)]
    error_s, sigma_s = np.array([(start.time_s - LEAD_S, start.sigma_s) for start in starts if start is not None]).T
    print(rate_hz, *(f"{1000 * late_s:.1f}+-{1000 * of_s:.1f}" for late_s, of_s in zip(error_s, sigma_s, strict=True)))  # noqa: T201
    assert len(error_s) == len(starts)
    assert np.mean(np.abs(error_s) < 2.0 * sigma_s) >= 0.95
    assert np.mean(np.abs(error_s) < 0.002) >= (0.85 if rate_hz < 50.0 else 1.0)
    assert np.median(np.abs(error_s)) < 0.001


@pytest.mark.accuracy
@pytest.mark.parametrize("rate_hz", [50.0, 60.0])
def test_walk_over_a_plate_tells_no_start(rate_hz: float) -> None:
    assert [start_of_walk(seed, rate_hz, ((0.0, 0.0),)) for seed in range(5)] == [None] * 5


def test_start_is_on_the_clock_of_the_frames() -> None:
    act = exercise(Gesture.JUMP, num_cameras=4)
    late = placed(act, simulated(act, LEAD_S, 6.0, plates_m(act, STANDING)), start_s=7.5)
    assert late.start is not None
    assert late.start.time_s == pytest.approx(7.5 + LEAD_S, abs=0.002)


def test_contacts_alone_tell_start_without_centre_of_mass() -> None:
    """Bodies without wrists have no centre of mass; ends of contacts are tens of milliseconds wrong, and stated so."""
    act = walk(1.2, num_cameras=4, rate_hz=30.0)
    laboratory = simulated(act, LEAD_S, 6.0, plates_m(act, ROW))
    animation = animated(act)
    names = tuple(name.replace("wrist", "cuff") for name in act.joints.names)
    joints = type(act.joints)(names, act.joints.bones)
    timebase = Timebase(0.0, act.rate_hz, animation.tracks[0].num_frames)
    found = placed_in_time(laboratory, animation, joints, timebase, Subject())
    assert found.start is not None
    assert found.check is not None
    assert found.check.mass_kg is None
    assert not found.check.is_ambiguous
    assert found.start.sigma_s > 0.015
    assert found.start.time_s == pytest.approx(LEAD_S, abs=3.0 * found.start.sigma_s)


def test_periodic_motion_is_ambiguous() -> None:
    act = exercise(Gesture.COUNTERMOVEMENT_JUMP, num_cameras=4)
    laboratory = placed(act, simulated(act, LEAD_S, 6.0, plates_m(act, STANDING)))
    assert laboratory.check is not None
    assert laboratory.check.is_ambiguous


def test_plates_elsewhere_tell_no_time() -> None:
    act = walk(1.2, num_cameras=4, rate_hz=30.0)
    laboratory = simulated(act, LEAD_S, 6.0, plates_m(act, ((0.0, 3.0),)))
    assert placed(act, laboratory).start is None


def test_stated_start_stays_beside_the_measured_one() -> None:
    act = exercise(Gesture.JUMP, num_cameras=4)
    stated = LaboratoryStart("trigger", LEAD_S + 0.2, 0.0003)
    given = simulated(act, LEAD_S, 6.0, plates_m(act, STANDING))
    found = placed(act, type(given)(**{name: getattr(given, name) for name in given.__slots__} | {"start": stated}))
    assert found.start == stated
    assert found.check is not None
    assert found.check.measured is not None
    assert found.check.measured.time_s == pytest.approx(LEAD_S, abs=0.002)


def test_body_without_feet_is_placed_too() -> None:
    act = body_only(exercise(Gesture.JUMP, num_cameras=4))
    assert act.joints == COCO_17
    full = exercise(Gesture.JUMP, num_cameras=4)
    laboratory = placed(act, simulated(full, LEAD_S, 6.0, plates_m(full, STANDING)))
    assert laboratory.start is not None
    assert laboratory.start.time_s == pytest.approx(LEAD_S, abs=0.004)


def test_world_that_moved_takes_plates_along() -> None:
    cameras = ring_of(3)
    move = Rigid3(np.eye(3), np.array([0.0, 0.0, -0.1]))
    moved = [type(camera)(**{name: getattr(camera, name) for name in camera.__slots__}
             | {"cam_from_world": camera.cam_from_world @ move.inverse()}) for camera in cameras]  # fmt: skip
    act = exercise(Gesture.JUMP, num_cameras=4)
    laboratory = simulated(act, LEAD_S, 1.0, plates_m(act, STANDING))
    found = in_world_of(moved, cameras, laboratory)
    np.testing.assert_allclose(found.world_from_laboratory.matrix, move.matrix, atol=1e-12)
    assert in_world_of(cameras, cameras, laboratory) is laboratory


@pytest.mark.parametrize(("length_s", "step"), [(4.19, 1), (6.0, 20)])
def test_files_of_any_length_and_rate_are_placed(length_s: float, step: int) -> None:
    """The last row of the coarse search may be rounded beyond the file; files may be slower than the search."""
    act = exercise(Gesture.JUMP, num_cameras=4)
    given = simulated(act, LEAD_S, length_s, plates_m(act, STANDING))
    assert len(given.samples) == round(length_s * 1000)
    samples, rate_hz = given.samples[::step], 1000.0 / step
    slow = replace(given, samples=samples, frame_rate_hz=rate_hz, samples_per_frame=1, num_frames=len(samples))
    found = placed(act, slow)
    assert found.start is not None
    assert found.start.time_s == pytest.approx(LEAD_S, abs=0.005)


def test_person_of_one_frame_tells_no_time() -> None:
    act = exercise(Gesture.JUMP, num_cameras=4)
    (motion,), (track,) = animated(act).motions, animated(act).tracks
    rows = slice(motion.contacts[0].start_frame, motion.contacts[0].start_frame + 1)
    part = replace(rows_of(motion, rows), start_frame=rows.start, contacts=clipped(motion.contacts, rows))
    animation = replace(animated(act), motions=(part,), tracks=(track.part(rows),))
    laboratory = simulated(act, LEAD_S, 1.0, plates_m(act, STANDING))
    found = placed_in_time(laboratory, animation, act.joints, Timebase(0.0, act.rate_hz, track.num_frames), Subject())
    assert found.start is None
    assert found.check is not None
    assert found.check.measured is None
