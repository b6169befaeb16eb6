"""Simulated people in a room, in the images of cameras whose extrinsics are not used."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera
from pipeline.core.data.detections import Detections
from pipeline.core.data.rigid import Rigid3
from pipeline.validation.simulation.motion.director import Cast
from pipeline.validation.simulation.rigs import Layout, Rig
from pipeline.validation.simulation.scenes import Scene, Simulation, record
from pipeline.validation.simulation.views.detector import DetectorAccuracy


def room(num_cameras: int, seed: int, duration_s: float = 60.0) -> Simulation:
    """Record people who walk about in a room, with noise of some pixels."""
    rig = Rig(Layout.RING, num_cameras, (4.0, 4.0), 2.2, focal_px=760.0)
    detector = DetectorAccuracy(noise_m=0.0, noise_px=3.0)
    return record(Scene(rig, Cast(2, (3.0, 3.0)), detector=detector, duration_s=duration_s), seed)


def bare(cameras: tuple[Camera, ...]) -> tuple[Camera, ...]:
    """Cameras without their extrinsics."""
    nowhere = Rigid3(read_only(np.eye(3)), read_only(np.zeros(3)))
    return tuple(replace(camera, cam_from_world=nowhere) for camera in cameras)


def without(detections: Detections) -> Detections:
    """Detections of a camera that sees nobody."""
    return replace(
        detections,
        frame=detections.frame[:0],
        keypoints_px=detections.keypoints_px[:0],
        score=detections.score[:0],
        box_px=detections.box_px[:0],
    )


@pytest.fixture(scope="session")
def walk() -> Simulation:
    """Two people in front of three cameras for twenty seconds."""
    return room(3, seed=3, duration_s=20.0)
