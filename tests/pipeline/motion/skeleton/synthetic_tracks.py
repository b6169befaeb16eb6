"""Synthetic walker with joints in closed form, and tracks of it."""

from collections.abc import Callable

import numpy as np

from pipeline.core.data.cameras import Timebase
from pipeline.core.data.people import Source, Track3D
from pipeline.core.joints import COCO_17

UPPER_ARM_M, FOREARM_M, THIGH_M, SHIN_M = 0.28, 0.25, 0.42, 0.40
HALF_SHOULDERS_M, HALF_HIPS_M, TRUNK_M = 0.18, 0.10, 0.50
EARS_ABOVE_SHOULDERS_M = 0.22

Angle = Callable[[np.ndarray], np.ndarray]


def walker(
    num_frames: int,
    frame_rate_hz: float = 30.0,
    *,
    turn_rad: float = 0.0,
    elbow_rad: Angle = lambda phase: np.full_like(phase, 0.9),
    shoulder_rad: Angle = lambda phase: -0.5 * np.sin(phase),
) -> np.ndarray:
    """World positions (frames, 17, 3) of a person who walks at one step a second, first towards -Y.

    Arms and legs swing in the body's sagittal plane: angles of hips and shoulders are positive forwards, elbows bend to
    the front and knees to the back.

    Parameters
    ----------
    turn_rad
        Turn of the person to the left over the whole walk.
    elbow_rad, shoulder_rad
        Angles of elbow and shoulder as functions of the gait's phase.
    """
    time_s = np.arange(num_frames) / frame_rate_hz
    heading = np.linspace(0.0, turn_rad, num_frames)
    forward = np.column_stack([np.sin(heading), -np.cos(heading), np.zeros(num_frames)])
    left = np.column_stack([np.cos(heading), np.sin(heading), np.zeros(num_frames)])
    up = np.array([0.0, 0.0, 1.0])

    def along(angle: np.ndarray) -> np.ndarray:
        return np.sin(angle)[:, None] * forward - np.cos(angle)[:, None] * up

    hips = np.cumsum(forward, axis=0) * 0.8 / frame_rate_hz + np.array([1.0, 2.0, 0.88])
    shoulders = hips + TRUNK_M * up
    ears = shoulders + EARS_ABOVE_SHOULDERS_M * up
    points = {"nose": ears + 0.110 * forward - 0.010 * up}
    for name, side in (("left", 1.0), ("right", -1.0)):
        phase = np.pi * time_s + (0.0 if side > 0 else np.pi)
        points[f"{name}_eye"] = ears + side * 0.032 * left + 0.080 * forward + 0.020 * up
        points[f"{name}_ear"] = ears + side * 0.075 * left
        shoulder = shoulders + side * HALF_SHOULDERS_M * left
        elbow = shoulder + UPPER_ARM_M * along(shoulder_rad(phase))
        hip = hips + side * HALF_HIPS_M * left
        thigh = 0.5 * np.sin(phase)
        knee = hip + THIGH_M * along(thigh)
        points[f"{name}_shoulder"], points[f"{name}_elbow"] = shoulder, elbow
        points[f"{name}_wrist"] = elbow + FOREARM_M * along(shoulder_rad(phase) + elbow_rad(phase))
        points[f"{name}_hip"], points[f"{name}_knee"] = hip, knee
        points[f"{name}_ankle"] = knee + SHIN_M * along(thigh - 0.5 - 0.3 * np.cos(phase))
    return np.stack([points[name] for name in COCO_17.names], axis=1)


def track_of(xyz_m: np.ndarray, track_id: int = 1, start_frame: int = 0) -> Track3D:
    """Make a track whose joints are measured in four views, and absent where NaN."""
    present = np.isfinite(xyz_m).all(-1)
    return Track3D(
        track_id=track_id,
        start_frame=start_frame,
        xyz_m=xyz_m,
        score=np.where(present, 0.9, 0.0),
        source=np.where(present, int(Source.MEASURED), int(Source.ABSENT)),
        error_px=np.where(present, 2.0, np.nan),
        views=np.where(present, 4, 0),
    )


def timebase(num_frames: int, frame_rate_hz: float = 30.0) -> Timebase:
    return Timebase(0.0, frame_rate_hz, num_frames)


def without(xyz_m: np.ndarray, *names: str, frames: slice = slice(None)) -> np.ndarray:
    """Set some joints to NaN."""
    seen = xyz_m.copy()
    seen[frames, COCO_17.indices(names)] = np.nan
    return seen
