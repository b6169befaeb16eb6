"""Shifts of cameras are compared with their own noise, whatever the size of their pictures."""

from dataclasses import replace

import numpy as np
import pytest
from jaxtyping import Float

from pipeline.calibration.adjustment.parameters import FOCAL, NUM_PARAMETERS, ROTATION, move_camera
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera
from pipeline.export.quality.camera_shifts import CameraShift, find_shifted, measure_shifts
from pipeline.geometry.camera import project
from pipeline.validation.simulation.rigs import Layout, Rig, build_cameras

NUM_INSTANTS, NUM_PEOPLE, NUM_JOINTS = 12, 5, 17
INSTANT = np.repeat(np.arange(NUM_INSTANTS), NUM_PEOPLE)
SMALL = 2


def _with_small_picture(camera: Camera) -> Camera:
    """Camera with pictures of an eighth of the size."""
    matrix = camera.matrix.copy()
    matrix[:2] /= 8.0
    return replace(camera, size_px=(160, 90), matrix=read_only(matrix))


CAMERAS = [
    _with_small_picture(camera) if number == SMALL else camera
    for number, camera in enumerate(build_cameras(Rig(Layout.RING, 5, (4.0, 4.0), 2.2), np.random.default_rng(8)))
]


def observe(noise_px: float = 2.0, seed: int = 0) -> Float[np.ndarray, "bodies cameras joints 2"]:
    """Joints at random places of people who stand on a floor of four by four metres."""
    rng = np.random.default_rng(seed)
    place_m = np.concatenate([rng.uniform(-2.0, 2.0, (len(INSTANT), 1, 2)), np.full((len(INSTANT), 1, 1), 0.9)], -1)
    people_m = place_m + rng.normal(0.0, [0.15, 0.15, 0.45], (len(INSTANT), NUM_JOINTS, 3))
    points_px = np.stack([project(camera, people_m) for camera in CAMERAS], axis=1)
    return points_px + noise_px * rng.normal(size=points_px.shape)


def shifted(cameras: list[Camera], points_px: Float[np.ndarray, "bodies cameras joints 2"]) -> list[CameraShift]:
    return find_shifted(cameras, points_px, INSTANT)


def moved(number: int, parameters: slice, step: float) -> list[Camera]:
    """Rig of which one camera is moved."""
    steps = np.zeros(NUM_PARAMETERS)
    steps[parameters.start] = step
    return [move_camera(camera, steps) if k == number else camera for k, camera in enumerate(CAMERAS)]


def test_small_picture_with_equal_noise_is_no_shift() -> None:
    """Two pixels of the small picture are 7 cm at the people."""
    assert shifted(CAMERAS, observe()) == []
    noise_px = [shift.noise_px for shift in measure_shifts(CAMERAS, observe(), INSTANT)]
    # The points err, too, by the noise of the others: least in the small picture.
    assert noise_px[SMALL] == pytest.approx(2.0, rel=0.1)


@pytest.mark.parametrize(
    ("parameters", "step"), [(ROTATION, np.radians(0.5)), (slice(2, 3), np.radians(3.0)), (FOCAL, 0.04)]
)
def test_turned_or_zoomed_camera_alone_is_named(parameters: slice, step: float) -> None:
    (shift,) = shifted(moved(1, parameters, step), observe())
    assert shift.camera == 1
    # The step leads back.
    assert shift.step[parameters.start] == pytest.approx(-step, rel=0.15)


def test_two_moved_cameras_are_named_worst_one_first() -> None:
    cameras = moved(1, ROTATION, np.radians(0.6))
    cameras[3] = moved(3, ROTATION, np.radians(1.5))[3]
    assert [shift.camera for shift in shifted(cameras, observe())] == [3, 1]


def test_bodies_of_other_people_are_no_shift() -> None:
    """A camera takes every third person for another one."""
    points_px = observe()
    points_px[::3, 1] = np.roll(points_px[::3, 1], 1, axis=0)
    assert shifted(CAMERAS, points_px) == []


def test_habits_of_detector_before_one_person_are_no_shift() -> None:
    """The joints of one person are half a deviation to the right in a camera, at all instants."""
    one = np.arange(len(INSTANT)) % NUM_PEOPLE == 0
    points_px = observe()[one]
    points_px[:, 1, :, 0] += 1.0
    assert find_shifted(CAMERAS, points_px, INSTANT[one]) == []


def test_exact_points_have_no_shift() -> None:
    assert shifted(CAMERAS, observe(noise_px=0.0)) == []


def test_cameras_that_see_nothing_in_common_have_no_shift() -> None:
    points_px = observe()
    points_px[:, 2:] = np.nan
    assert measure_shifts(CAMERAS, points_px, INSTANT) == []
    assert find_shifted(CAMERAS, points_px[:0], INSTANT[:0]) == []
