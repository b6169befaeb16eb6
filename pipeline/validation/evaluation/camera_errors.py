"""Errors of cameras against true ones, and cameras that are disturbed on purpose or lose their extrinsics."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from pipeline.calibration.adjustment.parameters import move_camera
from pipeline.calibration.people.calibrate_people import calibrate_people
from pipeline.calibration.similarity import align_world, shift_m, turn_deg
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera, FrameTimes
from pipeline.core.data.detections import Detections
from pipeline.core.data.rigid import Rigid3
from pipeline.core.joints import JointSet
from pipeline.validation.simulation.scenes import Simulation


def disturb_calibration(simulation: Simulation, turn_deg: float, shift_m: float, seed: int) -> Simulation:
    """Turn and shift every camera of the calibration by given amounts in random directions; the images stay."""
    rng = np.random.default_rng(seed)

    def disturb(camera: Camera) -> Camera:
        axis, direction = (vector / np.linalg.norm(vector) for vector in rng.normal(size=(2, 3)))
        return move_camera(camera, np.concatenate([np.radians(turn_deg) * axis, shift_m * direction, [0.0]]))

    return replace(simulation, cameras=tuple(map(disturb, simulation.cameras)))


def camera_errors(true: Sequence[Camera], found: Sequence[Camera]) -> dict[str, float]:
    """Largest errors of cameras.

    The result has:

    - ``rotation_deg``, ``translation_mm``: after the world of the found cameras is moved by the similarity that fits
      most cameras best: cameras that are refined from people keep a world of their own.
    - ``world_rotation_deg``, ``world_translation_mm``: as they are.
    """
    aligned = align_world(true, found)
    return {
        "rotation_deg": max(map(turn_deg, true, aligned)),
        "translation_mm": 1000.0 * max(map(shift_m, true, aligned)),
        "world_rotation_deg": max(map(turn_deg, true, found)),
        "world_translation_mm": 1000.0 * max(map(shift_m, true, found)),
    }


def without_extrinsics(
    cameras: Sequence[Camera],
    times: Mapping[str, FrameTimes],
    detections: Mapping[str, Detections],
    joints: JointSet,
    stature_m: Sequence[float],
) -> tuple[tuple[Camera, ...], dict[str, float]]:
    """Throw the extrinsics of cameras away, and find them from people.

    Returns cameras in the true world, into which the similarity moves them that fits most cameras best, and their
    largest errors: ``cameras_people_rotation_deg`` and ``cameras_people_translation_mm``.
    """
    nowhere = Rigid3(read_only(np.eye(3)), read_only(np.zeros(3)))
    bare = [replace(camera, cam_from_world=nowhere) for camera in cameras]
    made = calibrate_people(bare, times, detections, joints, stature_m, has_intrinsics=True)
    errors = camera_errors(cameras, made.cameras)
    kept = ("rotation_deg", "translation_mm")
    return align_world(cameras, made.cameras), {f"cameras_people_{name}": errors[name] for name in kept}
