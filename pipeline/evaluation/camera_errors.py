"""Errors of cameras against true ones, and cameras that are disturbed on purpose."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pipeline.calibration.adjustment.parameters import move_camera
from pipeline.calibration.similarity import align_world, shift_m, turn_deg
from pipeline.data.cameras import Camera
from pipeline.simulation.scenes import Simulation


def disturb_calibration(simulation: Simulation, turn_deg: float, shift_m: float, seed: int) -> Simulation:
    """Turn and shift every camera of the calibration by given amounts in random directions; the images stay."""
    rng = np.random.default_rng(seed)

    def disturb(camera: Camera) -> Camera:
        axis, direction = (vector / np.linalg.norm(vector) for vector in rng.normal(size=(2, 3)))
        return move_camera(camera, np.concatenate([np.radians(turn_deg) * axis, shift_m * direction, [0.0]]))

    return replace(simulation, cameras=tuple(map(disturb, simulation.cameras)))


def camera_errors(true: Sequence[Camera], found: Sequence[Camera]) -> dict[str, float]:
    """Largest errors of cameras.

    Returns
    -------
    rotation_deg, translation_mm
        After the world of the found cameras is moved by the similarity that fits most cameras best: cameras that are
        refined from people keep a world of their own.
    world_rotation_deg, world_translation_mm
        As they are.
    """
    aligned = align_world(true, found)
    return {
        "rotation_deg": max(map(turn_deg, true, aligned)),
        "translation_mm": 1000.0 * max(map(shift_m, true, aligned)),
        "world_rotation_deg": max(map(turn_deg, true, found)),
        "world_translation_mm": 1000.0 * max(map(shift_m, true, found)),
    }
