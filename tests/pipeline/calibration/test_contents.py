"""Units that nothing states: metres where they are possible, else a question with two candidates."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.calibration.contents import possible_units, question, scaled
from pipeline.core.data.cameras import Camera
from pipeline.core.data.rigid import Rigid3
from pipeline.core.options.job_choices import Units
from pipeline.validation.simulation.rigs import Layout, Rig, build_cameras

RING = build_cameras(Rig(Layout.RING, 4, (4.0, 3.0), 2.2), np.random.default_rng(1))


@pytest.mark.parametrize("size", [0.1, 1.0, 5.0])
def test_lengths_that_can_be_metres_are_metres(size: float) -> None:
    assert possible_units([scaled(camera, size) for camera in RING]) == ("m",)


@pytest.mark.parametrize(
    ("factor", "units"),
    [(1000.0, ("mm", "m")), (100.0, ("mm", "cm", "m")), (10.0, ("cm", "m")), (1e5, ("mm", "m"))],
)
def test_other_lengths_are_asked_for(factor: float, units: tuple[Units, ...]) -> None:
    """The ring is 8 m wide."""
    assert possible_units([scaled(camera, factor) for camera in RING]) == units


def test_survey_coordinates_are_metres() -> None:
    """A rig of 8 m, 500 km from the origin."""
    assert possible_units([placed(camera, np.array([5e5, 3e5, 40.0])) for camera in RING]) == ("m",)


def test_farthest_camera_is_named_with_both_distances() -> None:
    """As of a calibration whose origin is the first camera."""
    rig = [placed(camera, -center(RING[0])) for camera in RING]
    farthest = max(rig, key=lambda camera: float(np.linalg.norm(center(camera))))
    distance_m = float(np.linalg.norm(center(farthest)))
    sentence = question([scaled(camera, 1000.0) for camera in rig], ("mm", "m"))
    assert f"camera {farthest.name} is {distance_m:.2g} m if they are millimetres" in sentence
    assert f"or {1000 * distance_m:,.0f} m if they are metres" in sentence


def center(camera: Camera) -> np.ndarray:
    return camera.cam_from_world.inverse().translation_m


def placed(camera: Camera, shift_m: np.ndarray) -> Camera:
    pose = camera.cam_from_world
    return replace(camera, cam_from_world=Rigid3(pose.rotation, pose.translation_m - pose.rotation @ shift_m))
