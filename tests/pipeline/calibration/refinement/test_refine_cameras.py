"""Refinement of calibrations that are off, and of calibrations that are not."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.calibration.adjustment.parameters import FOCAL, move_camera, offsets, world_moves
from pipeline.calibration.refinement.refine_cameras import adjust_to_sightings, refine
from pipeline.calibration.similarity import align_world, shift_m, turn_deg
from pipeline.core.data.cameras import Camera
from pipeline.geometry.camera import project
from tests.pipeline.calibration.refinement.people import disturb, ring, see, walk

ADJUSTED_CAMERAS = ring()


def test_exact_sightings_give_exact_cameras_despite_wrong_views() -> None:
    rng = np.random.default_rng(1)
    given_cameras = [disturb(camera, rng) for camera in ADJUSTED_CAMERAS]
    sightings = see(ADJUSTED_CAMERAS, *walk(10.0), noise_px=0.0)
    found = adjust_to_sightings(given_cameras, given_cameras, sightings).adjusted
    errors = offsets(ADJUSTED_CAMERAS, align_world(ADJUSTED_CAMERAS, found.cameras))
    np.testing.assert_allclose(errors, 0.0, atol=5e-4)


def test_moves_of_world_change_no_picture() -> None:
    point_m, tiny = np.array([[0.3, -0.2, 1.1]]), 1e-6
    center_m = np.mean([camera.cam_from_world.inverse().translation_m for camera in ADJUSTED_CAMERAS], axis=0)
    arm_m = point_m - center_m
    of_point = [*np.eye(3), *(np.cross(axis, arm_m[0]) for axis in np.eye(3)), arm_m[0]]
    for number, camera in enumerate(ADJUSTED_CAMERAS):
        for k, point_step in enumerate(of_point):
            moved = move_camera(camera, tiny * world_moves(ADJUSTED_CAMERAS)[number, :, k])
            np.testing.assert_allclose(project(moved, point_m + tiny * point_step), project(camera, point_m), atol=1e-6)


CAMERAS = ring(4)


def differences(true: tuple[Camera, ...], found: tuple[Camera, ...]) -> tuple[float, float]:
    """Largest turn in degrees and largest shift in metres after the worlds are aligned."""
    aligned = align_world(true, found)
    pairs = list(zip(true, aligned, strict=True))
    return max(turn_deg(*pair) for pair in pairs), max(shift_m(*pair) for pair in pairs)


@pytest.mark.slow
def test_disturbed_cameras_come_back() -> None:
    rng = np.random.default_rng(3)
    given = tuple(disturb(camera, rng) for camera in CAMERAS)
    found = refine(given, given, see(CAMERAS, *walk(40.0)))
    assert found.is_refined
    assert found.error_after_px < 0.6 * found.error_before_px
    far_deg, far_m = differences(CAMERAS, found.cameras)
    # A detector could mark joints beside their places: some millimetres of the given positions stay.
    assert far_deg <= 0.1
    assert far_m <= 0.01
    # The world is the given one as far as the given cameras agree on it.
    assert max(shift_m(then, now) for then, now in zip(given, found.cameras, strict=True)) < 0.05


@pytest.mark.slow
def test_good_calibration_is_not_touched() -> None:
    found = refine(CAMERAS, CAMERAS, see(CAMERAS, *walk(20.0)))
    assert not found.is_refined
    assert (found.refusal, found.cameras) == ("no_better", CAMERAS)
    assert max(move.moved_px for move in found.moves) < 3.0
    assert found.error_after_px == pytest.approx(found.error_before_px, rel=0.02)
    assert found.steps == ()


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("num_people", [1, 3])
def test_all_cameras_half_a_degree_off_are_mended(seed: int, num_people: int) -> None:
    rng = np.random.default_rng(seed)
    given = tuple(disturb(camera, rng, 0.5, 0.01) for camera in CAMERAS)
    found = refine(given, given, see(CAMERAS, *walk(8.0, seed, num_people), seed=seed))
    assert found.is_refined
    assert differences(CAMERAS, found.cameras)[0] < 0.6 * differences(CAMERAS, given)[0]


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_marks_beside_joints_are_no_evidence(seed: int) -> None:
    """Each camera sees each joint 1.5 cm beside its place: at 4.5 m and 760 px, 2.5 px."""
    sightings = see(CAMERAS, *walk(8.0, seed), seed=seed)
    bias_px = np.random.default_rng(seed).normal(0.0, 2.5, (12, len(CAMERAS), 2))
    found = refine(CAMERAS, CAMERAS, replace(sightings, points_px=sightings.points_px + bias_px[sightings.joint]))
    assert (found.refusal, found.cameras) == ("no_better", CAMERAS)


@pytest.mark.slow
def test_one_camera_that_was_turned_is_one_that_moves() -> None:
    step = np.array([0.0, np.radians(2.0), 0.0, 0.0, 0.0, 0.0, 0.0])
    given = (CAMERAS[0], move_camera(CAMERAS[1], step), *CAMERAS[2:])
    found = refine(given, given, see(CAMERAS, *walk(20.0)))
    turns_deg = [turn_deg(then, now) for then, now in zip(given, found.cameras, strict=True)]
    assert turns_deg[1] == pytest.approx(2.0, abs=0.15)
    assert max(turns_deg[0], *turns_deg[2:]) < 0.15


def _with_small_picture(camera: Camera) -> Camera:
    """Camera with a fifth of the pixels along each side."""
    scale = np.diag([0.2, 0.2, 1.0])
    width, height = camera.size_px
    return replace(camera, size_px=(width // 5, height // 5), matrix=scale @ camera.matrix)


@pytest.mark.slow
@pytest.mark.parametrize(("small_deg", "large_deg"), [(2.0, 1.0), (0.6, 0.3)])
def test_camera_that_moved_most_in_its_own_picture_comes_first(small_deg: float, large_deg: float) -> None:
    """A camera with large pixels turns by twice the angle of another one, which is two fifths of its pixels."""
    true = (CAMERAS[0], _with_small_picture(CAMERAS[1]), *CAMERAS[2:])
    turns = np.zeros((4, 7))
    turns[1, 0], turns[2, 1] = np.radians(small_deg), np.radians(large_deg)
    given = tuple(move_camera(camera, turn) for camera, turn in zip(true, turns, strict=True))
    refined = refine(given, given, see(true, *walk(8.0), noise_px=0.5))
    first, second = refined.moves[:2]
    assert (first.camera, second.camera) == (CAMERAS[2].name, CAMERAS[1].name)
    assert first.rotation_deg < second.rotation_deg
    # Near the axis a turn shifts the picture by the focal length times the angle; of a small one not all is believed.
    assert first.moved_px == pytest.approx(760.0 * np.radians(large_deg), rel=0.45)
    assert second.moved_px == pytest.approx(152.0 * np.radians(small_deg), rel=0.45)


@pytest.mark.slow
def test_wrong_focal_length_is_found() -> None:
    zoom = np.zeros(7)
    zoom[FOCAL] = 0.06
    given = (move_camera(CAMERAS[0], zoom), *CAMERAS[1:])
    found = refine(given, given, see(CAMERAS, *walk(40.0), noise_px=1.0))
    assert found.is_refined
    ratios = [now.matrix[0, 0] / then.matrix[0, 0] for then, now in zip(CAMERAS, found.cameras, strict=True)]
    assert ratios[0] / np.mean(ratios[1:]) == pytest.approx(1.0, abs=0.015)


@pytest.mark.slow
@pytest.mark.parametrize("num_seen", [0, 4, 40])
def test_camera_with_few_views_moves_as_far_as_they_tell(num_seen: int) -> None:
    rng = np.random.default_rng(4)
    given = tuple(disturb(camera, rng) for camera in CAMERAS)
    sightings = see(CAMERAS, *walk(20.0))
    hidden = np.zeros(sightings.points_px.shape[:2], bool)
    hidden[num_seen:, 3] = True
    found = refine(given, given, sightings.without(hidden))
    assert found.is_refined
    assert turn_deg(given[0], found.cameras[0]) > 0.1
    error_deg = turn_deg(CAMERAS[3], align_world(CAMERAS, found.cameras)[3])
    assert error_deg <= turn_deg(CAMERAS[3], align_world(CAMERAS, given)[3]) + 0.02
    assert (turn_deg(given[3], found.cameras[3]) > 0.05) == (num_seen > 0)


def test_too_few_people_change_nothing() -> None:
    given = tuple(disturb(camera, np.random.default_rng(5)) for camera in CAMERAS)
    sightings = see(CAMERAS, *walk(0.2, num_people=1))
    found = refine(given, given, sightings)
    assert (found.refusal, found.moves) == ("few_people", ())
    assert found.cameras == given
    assert np.isnan(found.error_before_px)
    nobody = sightings.subset(np.zeros(len(sightings), bool))
    assert refine(given, given, replace(nobody)).num_points == 0


@pytest.mark.parametrize("num_instants", [1, 2])
def test_take_of_few_instants_is_not_refined(num_instants: int) -> None:
    """No part of the take is left that could tell whether cameras are better."""
    sightings = see(CAMERAS, *walk(0.2 * num_instants, num_people=8))
    assert len(sightings) >= 60
    refined = refine(CAMERAS, CAMERAS, sightings)
    assert refined.refusal == "no_better"
    assert refined.cameras == CAMERAS
