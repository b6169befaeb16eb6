"""Standing body in an image, and outputs that BlazePose would give for it."""

from collections.abc import Mapping

import numpy as np

from pipeline.core.joints import COCO_17
from pipeline.detection.topdown.blazepose import CROP_PX, LANDMARK, LANDMARKS, PoseOutputs, decode_pose
from pipeline.detection.topdown.regions import Region

_STANDING = {
    "nose": (0, -160),
    "left_eye": (5, -165),
    "right_eye": (-5, -165),
    "left_ear": (12, -162),
    "right_ear": (-12, -162),
    "left_shoulder": (30, -120),
    "right_shoulder": (-30, -120),
    "left_elbow": (45, -70),
    "right_elbow": (-45, -70),
    "left_wrist": (50, -20),
    "right_wrist": (-50, -20),
    "left_hip": (18, 0),
    "right_hip": (-18, 0),
    "left_knee": (20, 80),
    "right_knee": (-20, 80),
    "left_ankle": (20, 160),
    "right_ankle": (-20, 160),
}
_BESIDE = {
    "left_heel": (18, 170),
    "right_heel": (-18, 170),
    "left_foot_index": (32, 178),
    "right_foot_index": (-32, 178),
    "left_index": (52, 20),
    "right_index": (-52, 20),
    "left_pinky": (60, 14),
    "right_pinky": (-60, 14),
}
CENTER_PX = np.array([300.0, 250.0])


def standing_px() -> np.ndarray:
    """Joints of ``COCO_17`` of a person who faces the camera."""
    return np.array([_STANDING[name] for name in COCO_17.names], float) + CENTER_PX


def landmarks_px() -> np.ndarray:
    """BlazePose's landmarks of the same person, where both networks agree; others at the centre."""
    known = _STANDING | _BESIDE
    return np.array([known.get(name, (0, 0)) for name in LANDMARKS], float) + CENTER_PX


def pose_of(
    points_px: np.ndarray,
    region: Region,
    peaks: Mapping[str, float] | None = None,
    regressed_px: np.ndarray | None = None,
) -> dict[str, np.ndarray]:
    """Outputs of a network that sees landmarks at these positions in a region.

    Parameters
    ----------
    peaks
        Heat of landmarks by name, 0.9 elsewhere.
    regressed_px
        Regressed positions, if they differ.
    """
    from_edge_px = region.crop_from_image(points_px, CROP_PX) + 0.5
    rows, columns = np.indices((64, 64))
    squared = (columns - from_edge_px[:, 0, None, None] / 4) ** 2 + (rows - from_edge_px[:, 1, None, None] / 4) ** 2
    heat = np.full(len(LANDMARKS), 0.9)
    for name, peak in (peaks or {}).items():
        heat[LANDMARK[name]] = peak
    maps = (heat[:, None, None] * np.exp(-squared / 2)).clip(1e-9, 1 - 1e-9)
    raw = np.zeros((1, 39, 5), np.float32)
    source_px = points_px if regressed_px is None else regressed_px
    raw[0, : len(LANDMARKS), :2] = region.crop_from_image(source_px, CROP_PX) + 0.5
    logits = np.full((1, 39, 64, 64), -20.0, np.float32)
    logits[0, : len(LANDMARKS)] = np.log(maps / (1 - maps))
    return {"landmarks": raw.reshape(1, 195), "heatmap": logits, "presence": np.ones((1, 1), np.float32)}


def decoded(points_px: np.ndarray, region: Region, peaks: Mapping[str, float] | None = None) -> PoseOutputs:
    return decode_pose(pose_of(points_px, region, peaks), region)
