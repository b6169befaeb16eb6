"""Units that nothing states: metres where they are possible, else a question with two candidates."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.calibration.contents import UNITS_M, Units, scaled
from pipeline.calibration.units import candidates, likely_unit
from pipeline.data.cameras import Camera
from pipeline.geometry.rigid import Rigid3
from pipeline.simulation.rigs import Layout, Rig, build_cameras

RING = build_cameras(Rig(Layout.RING, 4, (4.0, 3.0), 2.2), np.random.default_rng(1))


@pytest.mark.parametrize("extent", [0.3, 1.0, 5.0])
@pytest.mark.parametrize("unit", ["m", "mm"])
def test_units_of_usual_rigs(unit: Units, extent: float) -> None:
    rig = [scaled(camera, extent / UNITS_M[unit]) for camera in RING]
    assert likely_unit(rig) == unit


def test_centimetres() -> None:
    assert likely_unit([scaled(camera, 100.0) for camera in RING]) == "cm"


def test_survey_coordinates_are_metres() -> None:
    """A rig of 8 m, 500 km from the origin."""
    assert likely_unit([placed(camera, np.array([5e5, 3e5, 40.0])) for camera in RING]) == "m"


def test_the_farthest_camera_is_named_with_both_distances() -> None:
    """As of a calibration whose origin is the first camera."""
    first = placed(RING[0], -center(RING[0]))
    rig = [first, *(placed(camera, -center(RING[0])) for camera in RING[1:])]
    farthest = max(rig, key=lambda camera: float(np.linalg.norm(center(camera))))
    distance_m = float(np.linalg.norm(center(farthest)))
    sentence = candidates([scaled(camera, 1000.0) for camera in rig], "mm")
    assert f"camera {farthest.name} is {distance_m:.2g} m from the origin if they are millimetres" in sentence
    assert f"or {1000 * distance_m:,.0f} m if they are metres" in sentence


def center(camera: Camera) -> np.ndarray:
    return camera.cam_from_world.inverse().translation_m


def placed(camera: Camera, shift_m: np.ndarray) -> Camera:
    pose = camera.cam_from_world
    return replace(camera, cam_from_world=Rigid3(pose.rotation, pose.translation_m - pose.rotation @ shift_m))
