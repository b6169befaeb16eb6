"""Sightings of simulated people: joints of bodies that walk about, projected with noise."""

import numpy as np
from jaxtyping import Float

from pipeline.calibration.adjustment.parameters import move_camera
from pipeline.calibration.refinement.sightings import JointSightings
from pipeline.core.data.cameras import Camera
from pipeline.geometry.camera import project
from pipeline.validation.simulation.rigs import Layout, Rig, build_cameras

BODY_M = np.array([[x, y, z] for z in (0.1, 0.5, 0.9, 1.1, 1.4, 1.6) for x, y in ((-0.2, 0.0), (0.2, 0.05))])


def ring(num_cameras: int = 4, seed: int = 0) -> tuple[Camera, ...]:
    return build_cameras(Rig(Layout.RING, num_cameras, (4.0, 4.0), 2.2, focal_px=760.0), np.random.default_rng(seed))


def disturb(camera: Camera, rng: np.random.Generator, turn_deg: float = 1.0, shift_m: float = 0.02) -> Camera:
    """Turn and shift a camera by given amounts in random directions."""
    axis, direction = (vector / np.linalg.norm(vector) for vector in rng.normal(size=(2, 3)))
    return move_camera(camera, np.concatenate([np.radians(turn_deg) * axis, shift_m * direction, [0.0]]))


def walk(
    duration_s: float, seed: int = 0, num_people: int = 2
) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, "p 3"]]:
    """Times and positions of the joints of people who cross a room of 4 m, five times a second."""
    rng = np.random.default_rng(seed)
    times_s, points_m = [], []
    for _ in range(num_people):
        time_s = np.arange(0.0, duration_s, 0.2)
        phase, rate = rng.uniform(0, 2 * np.pi, 2), rng.uniform(0.3, 0.6, 2)
        place_m = np.column_stack([1.8 * np.sin(rate * time_s[:, None] + phase), np.zeros(len(time_s))])
        swing_m = rng.normal(0.0, 0.08, (len(time_s), len(BODY_M), 3))
        points_m.append((place_m[:, None] + BODY_M + swing_m).reshape(-1, 3))
        times_s.append(np.repeat(time_s, len(BODY_M)))
    return np.concatenate(times_s), np.concatenate(points_m)


def see(
    cameras: tuple[Camera, ...],
    time_s: Float[np.ndarray, " p"],
    points_m: Float[np.ndarray, "p 3"],
    noise_px: float = 2.5,
    seed: int = 0,
) -> JointSightings:
    """Sightings of points by exact cameras: noise, and every twentieth view far off."""
    rng = np.random.default_rng(seed)
    points_px = np.stack([project(camera, points_m) for camera in cameras], axis=1)
    points_px += rng.normal(0.0, noise_px, points_px.shape)
    is_wrong = rng.random(points_px.shape[:2]) < 0.05
    points_px += np.where(is_wrong[..., None], rng.normal(0.0, 40.0, points_px.shape), 0.0)
    square = np.unique(np.floor(points_m[:, :2] / 0.5), axis=0, return_inverse=True)[1].reshape(-1)
    return JointSightings(time_s, points_px, np.arange(len(points_m)) % len(BODY_M), square)
