"""Ring of cameras, a standing body, and exact detections of people for tests."""

import numpy as np
import pytest

from pipeline.core.data.cameras import Camera
from pipeline.core.data.detections import Detections
from pipeline.core.data.rigid import Rigid3
from pipeline.geometry.camera import project


def ring_camera(name: str, angle_rad: float, radius_m: float = 4.0, height_m: float = 2.0) -> Camera:
    """Make a camera on a circle that looks at a point one metre above the origin."""
    center = np.array([radius_m * np.cos(angle_rad), radius_m * np.sin(angle_rad), height_m])
    forward = np.array([0.0, 0.0, 1.0]) - center
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    matrix = np.array([[800.0, 0.0, 639.5], [0.0, 800.0, 479.5], [0.0, 0.0, 1.0]])
    return Camera(
        name, (1280, 960), matrix, np.array([-0.1, 0.02, 0.0, 0.0, 0.0]), Rigid3(rotation, -rotation @ center)
    )


@pytest.fixture
def ring() -> tuple[Camera, ...]:
    return tuple(ring_camera(f"cam{k}", angle) for k, angle in enumerate(np.deg2rad([10.0, 100.0, 190.0, 280.0])))


def body(num_joints: int = 17) -> np.ndarray:
    """World positions (joints, 3) of a standing body around the origin, from the floor to 1.7 m."""
    rng = np.random.default_rng(7)
    shape = rng.uniform([-0.25, -0.25, 0.0], [0.25, 0.25, 1.7], (num_joints, 3))
    shape[0, 2], shape[-1, 2] = 1.7, 0.0
    return shape


def detections_of(camera: Camera, people_m: np.ndarray, order: np.ndarray | None = None) -> Detections:
    """Exact detections of people (people, frames, joints, 3) with score 0.9; ``order`` shuffles the people."""
    num_people, num_frames = people_m.shape[:2]
    order = np.arange(num_people) if order is None else order
    points_px = np.concatenate([project(camera, people_m[order, frame]) for frame in range(num_frames)])
    return Detections(
        camera=camera.name,
        frame=np.repeat(np.arange(num_frames), num_people),
        keypoints_px=points_px,
        score=np.full(points_px.shape[:2], 0.9),
        box_px=np.concatenate([points_px.min(1), points_px.max(1)], axis=1),
    )
