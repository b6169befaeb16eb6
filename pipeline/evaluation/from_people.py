"""Cameras of a benchmark without their extrinsics, which people give back."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from pipeline.calibration.people.calibrate import calibrate_people
from pipeline.calibration.similarity import align_world
from pipeline.data.arrays import read_only
from pipeline.data.cameras import Camera, FrameTimes
from pipeline.data.detections import Detections
from pipeline.evaluation.camera_errors import camera_errors
from pipeline.geometry.rigid import Rigid3
from pipeline.joints import JointSet


def without_extrinsics(
    cameras: Sequence[Camera],
    times: Mapping[str, FrameTimes],
    detections: Mapping[str, Detections],
    joints: JointSet,
    stature_m: Sequence[float],
) -> tuple[tuple[Camera, ...], dict[str, float]]:
    """Throw the extrinsics of cameras away, and find them from people.

    Returns
    -------
        Cameras in the true world, into which the similarity moves them that fits most cameras best, and their errors:
        ``cameras_people_rotation_deg`` and ``cameras_people_translation_mm``, the largest ones.
    """
    nowhere = Rigid3(read_only(np.eye(3)), read_only(np.zeros(3)))
    bare = [replace(camera, cam_from_world=nowhere) for camera in cameras]
    made = calibrate_people(bare, times, detections, joints, stature_m, has_intrinsics=True)
    errors = camera_errors(cameras, made.cameras)
    kept = ("rotation_deg", "translation_mm")
    return align_world(cameras, made.cameras), {f"cameras_people_{name}": errors[name] for name in kept}
