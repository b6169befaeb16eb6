"""Errors of cameras."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.calibration.similarity import shift_m, turn_deg
from pipeline.core.data.cameras import Camera
from pipeline.core.data.rigid import Rigid3
from pipeline.validation.evaluation.camera_errors import camera_errors, disturb_calibration
from pipeline.validation.simulation.scenes import find_scene, record


def test_disturbed_cameras_are_off_by_given_amounts() -> None:
    simulation = record(replace(find_scene("room"), duration_s=0.2), seed=0)
    disturbed = disturb_calibration(simulation, 1.0, 0.02, seed=4)
    for true, camera in zip(simulation.cameras, disturbed.cameras, strict=True):
        assert turn_deg(true, camera) == pytest.approx(1.0)
        assert shift_m(true, camera) == pytest.approx(0.02)
    errors = camera_errors(simulation.cameras, disturbed.cameras)
    assert errors["world_rotation_deg"] == pytest.approx(1.0)
    assert errors["world_translation_mm"] == pytest.approx(20.0)
    assert errors["rotation_deg"] > 0.4


def test_another_world_is_no_error_of_cameras() -> None:
    cameras = record(replace(find_scene("room"), duration_s=0.2), seed=0).cameras

    def shifted(camera: Camera) -> Camera:
        pose = camera.cam_from_world
        return replace(camera, cam_from_world=Rigid3(pose.rotation, pose.translation_m - pose.rotation[:, 0] * 0.1))

    errors = camera_errors(cameras, [shifted(camera) for camera in cameras])
    assert errors["translation_mm"] == pytest.approx(0.0, abs=0.01)
    assert errors["world_translation_mm"] == pytest.approx(100.0)
    np.testing.assert_allclose([errors["rotation_deg"], errors["world_rotation_deg"]], 0.0, atol=1e-3)
