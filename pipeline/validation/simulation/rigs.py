"""Simulated camera rigs: rings, ceilings and domes; and frame times of their cameras."""

from dataclasses import dataclass
from enum import Enum

import numpy as np

from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera, FrameTimes, LensModel
from pipeline.geometry.camera import look_at


class Layout(Enum):
    """Arrangement of the cameras of a rig."""

    RING = "ring"
    CEILING = "ceiling"
    DOME = "dome"


@dataclass(frozen=True, slots=True)
class Rig:
    """Rig of cameras around the origin."""

    # ``RING``: on an ellipse at one height. ``CEILING``: half of the cameras along the walls, half inside. ``DOME``:
    # spread over a hemisphere.
    layout: Layout
    num_cameras: int  # Number of cameras
    # Half axes of the ellipse or of the ceiling along X and Y; the first is the radius of a dome
    extent_m: tuple[float, float]
    height_m: float  # Height of the ring, of the ceiling, or of the dome's lowest cameras
    # Width and height of the image, and mean focal length
    size_px: tuple[int, int] = (1280, 720)
    focal_px: float = 800.0
    target_height_m: float = 1.0  # Height of the point at which cameras look
    # OpenCV's k1, k2, p1, p2, k3, of a fisheye lens k1, k2, k3, k4; each camera's coefficients differ from these by up
    # to a tenth
    distortion: tuple[float, ...] = (-0.10, 0.03, 0.0005, -0.0004, 0.0)
    lens: LensModel = "standard"  # Distortion model


def build_cameras(rig: Rig, rng: np.random.Generator) -> tuple[Camera, ...]:
    """Build the cameras of a rig, named ``cam_00``, ``cam_01`` and so on around the scene.

    Focal lengths vary by a few percent, positions by some centimetres; the records are exact.
    """
    centers_m, targets_m = _PLACES[rig.layout](rig)
    around = np.argsort(np.arctan2(centers_m[:, 1], centers_m[:, 0]) % (2 * np.pi))
    centers_m, targets_m = centers_m[around], targets_m[around]
    centers_m = centers_m + rng.uniform(-0.05, 0.05, centers_m.shape)
    targets_m = targets_m + rng.uniform(-0.2, 0.2, targets_m.shape)
    return tuple(
        _camera(f"cam_{number:02d}", center_m, target_m, rig, rng)
        for number, (center_m, target_m) in enumerate(zip(centers_m, targets_m, strict=True))
    )


def _camera(name: str, center_m: np.ndarray, target_m: np.ndarray, rig: Rig, rng: np.random.Generator) -> Camera:
    width_px, height_px = rig.size_px
    focal_px = rig.focal_px * rng.uniform(0.98, 1.02)
    center_px = np.array([(width_px - 1) / 2, (height_px - 1) / 2]) + rng.uniform(-0.01, 0.01, 2) * width_px
    matrix = np.array([[focal_px, 0.0, center_px[0]], [0.0, focal_px, center_px[1]], [0.0, 0.0, 1.0]])
    distortion = np.array(rig.distortion) * rng.uniform(0.9, 1.1, len(rig.distortion))
    pose = look_at(center_m, target_m)
    return Camera(name, rig.size_px, read_only(matrix), read_only(distortion), pose, lens=rig.lens)


def choose_views(num_cameras: int, num_views: int) -> list[int]:
    """Choose cameras of a rig, as numbers: evenly spread, and two cameras at a right angle, not face to face."""
    if num_views == 2:
        return [0, max(1, num_cameras // 4)]
    return [view * num_cameras // num_views for view in range(num_views)]


def _ring(rig: Rig) -> tuple[np.ndarray, np.ndarray]:
    # A quarter step off the axes, so that no two cameras face each other along a wall.
    angle = 2 * np.pi * (np.arange(rig.num_cameras) + 0.25) / rig.num_cameras
    centers_m = np.column_stack(
        [rig.extent_m[0] * np.cos(angle), rig.extent_m[1] * np.sin(angle), np.full(rig.num_cameras, rig.height_m)]
    )
    return centers_m, np.tile([0.0, 0.0, rig.target_height_m], (rig.num_cameras, 1))


def _ceiling(rig: Rig) -> tuple[np.ndarray, np.ndarray]:
    """Place half of the cameras along the walls, facing the centre, and half inside, facing the opposite half."""
    outer = (rig.num_cameras + 1) // 2
    angle = 2 * np.pi * (np.arange(outer) + 0.25) / outer
    ring_m = np.column_stack([rig.extent_m[0] * np.cos(angle), rig.extent_m[1] * np.sin(angle)])
    inner = 2 * np.pi * np.arange(rig.num_cameras - outer) / max(rig.num_cameras - outer, 1)
    inside_m = 0.55 * np.column_stack([rig.extent_m[0] * np.cos(inner), rig.extent_m[1] * np.sin(inner)])
    places_m = np.concatenate([ring_m, inside_m])
    targets_m = np.concatenate([0.1 * ring_m, -0.5 * inside_m])
    heights = np.ones((len(places_m), 1))
    return np.hstack([places_m, heights * rig.height_m]), np.hstack([targets_m, heights * rig.target_height_m])


def _dome(rig: Rig) -> tuple[np.ndarray, np.ndarray]:
    """Place cameras evenly in angle and in height up to 60 degrees of elevation, neighbours at different heights."""
    number = np.arange(rig.num_cameras)
    radius_m = rig.extent_m[0]
    lowest, highest = rig.height_m / radius_m, np.sin(np.deg2rad(60.0))
    # Multiples of the golden ratio modulo 1 fill an interval evenly; equal areas on a sphere have equal heights.
    rise = lowest + (highest - lowest) * (number * (np.sqrt(5) - 1) / 2 % 1)
    angle = 2 * np.pi * number / rig.num_cameras
    flat = np.sqrt(1 - rise**2)
    centers_m = radius_m * np.column_stack([flat * np.cos(angle), flat * np.sin(angle), rise])
    return centers_m, np.tile([0.0, 0.0, rig.target_height_m], (rig.num_cameras, 1))


_PLACES = {Layout.RING: _ring, Layout.CEILING: _ceiling, Layout.DOME: _dome}


@dataclass(frozen=True, slots=True)
class Clock:
    """Frame rates and phases of the cameras."""

    frame_rate_hz: float = 25.0  # Rate of the output frames, and of synchronised cameras
    # Rates of the cameras, repeated in turn; empty if all cameras have the common rate
    camera_rates_hz: tuple[float, ...] = ()
    random_phase: bool = False  # True if each camera starts at a random time within its first period
    dropped: float = 0.0  # Share of frames that are dropped


def frame_times(clock: Clock, number: int, duration_s: float, rng: np.random.Generator) -> FrameTimes:
    """Draw the times of a camera's frames in [0, duration). The camera's ``number`` selects its rate."""
    rate_hz = (
        clock.camera_rates_hz[number % len(clock.camera_rates_hz)] if clock.camera_rates_hz else clock.frame_rate_hz
    )
    phase, fate = rng.random(), rng.random(int(np.ceil(duration_s * rate_hz)) + 1)
    time_s = (np.arange(len(fate)) + (phase if clock.random_phase else 0.0)) / rate_hz
    return FrameTimes(read_only(time_s[(fate >= clock.dropped) & (time_s < duration_s - 1e-9)]))
