"""Heads of people in the world: spheres around them at every time at which a person is known to be there."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from pipeline.core.data.cameras import Timebase
from pipeline.core.data.people import Track3D
from pipeline.core.joints import JointSet

FACE = ("nose", "left_eye", "right_eye", "left_ear", "right_ear")
"""Joints of the head."""

HOLD_S = 0.5
"""Time before the first and after the last frame of a track for which its head is expected where it was."""

# Radii of spheres, by what is known of the head. A head reaches 0.13 m from its middle; hair, hats and the errors of
# joints come on top.
_OF_EARS_M, _OF_FACE_M, _OF_TRUNK_M, _OF_SHOULDERS_M, _OF_HIPS_M = 0.20, 0.24, 0.32, 0.36, 0.70
# Distance of the middle of the head from the middle between the shoulders, for each metre of the trunk and in metres,
# and from the middle between the hips.
_NECK_BY_TRUNK, _NECK_M, _ABOVE_HIPS_M = 0.5, 0.25, 0.75
# A head of which nothing is known moves at most so fast, and the sphere grows by this much at most.
_SPEED_M_S, _MAX_GROWTH_M = 1.0, 0.5
# Standard deviations of joints by which spheres grow.
_SIGMAS, _MAX_SIGMAS_M = 2.0, 0.3


@dataclass(frozen=True, slots=True, eq=False)
class HeadPath:
    """Sphere around a person's head over time."""

    time_s: Float[np.ndarray, " frames"]  # Ascending times on the session's clock
    center_m: Float[np.ndarray, "frames 3"]  # World coordinates, never NaN
    radius_m: Float[np.ndarray, " frames"]

    def at(self, time_s: float) -> tuple[Float[np.ndarray, " 3"], float] | None:
        """Centre and radius at a time; ``None`` more than ``HOLD_S`` before the first and after the last frame."""
        away_s = max(float(self.time_s[0]) - time_s, time_s - float(self.time_s[-1]), 0.0)
        if away_s > HOLD_S:
            return None
        center_m = np.array([np.interp(time_s, self.time_s, self.center_m[:, axis]) for axis in range(3)])
        radius_m = float(np.interp(time_s, self.time_s, self.radius_m))
        return center_m, radius_m + min(_SPEED_M_S * away_s, _MAX_GROWTH_M)


def head_path(track: Track3D, joints: JointSet, timebase: Timebase) -> HeadPath | None:
    """Sphere around the head of a person in each frame of a track, also where the joints of the head are unknown.

    The less is known, the larger is the sphere: around the ears, the face, above the shoulders, the hips. Frames in
    which nothing is known have a sphere between those of the frames around them. ``None`` if no frame has any of these
    joints.
    """
    center_m, radius_m = _spheres(track, joints)
    is_known = np.isfinite(radius_m)
    if not is_known.any():
        return None
    frames = np.arange(track.num_frames)
    known = frames[is_known]
    away = np.abs(
        frames[:, None] - known[np.clip(np.searchsorted(known, frames)[:, None] + [-1, 0], 0, len(known) - 1)]
    )
    growth_m = np.minimum(_SPEED_M_S * away.min(axis=1) / timebase.frame_rate_hz, _MAX_GROWTH_M)
    filled_m = np.stack([np.interp(frames, known, center_m[is_known, axis]) for axis in range(3)], axis=1)
    time_s = timebase.start_time_s + (track.start_frame + frames) / timebase.frame_rate_hz
    return HeadPath(time_s, filled_m, np.interp(frames, known, radius_m[is_known]) + growth_m)


def _spheres(track: Track3D, joints: JointSet) -> tuple[Float[np.ndarray, "frames 3"], Float[np.ndarray, " frames"]]:
    """Centres and radii from the joints of each frame alone, NaN where they tell nothing."""
    shoulders_m, hips_m = _middle(track, joints, "shoulder"), _middle(track, joints, "hip")
    up = np.array([0.0, 0.0, 1.0])
    # From the vaguest to the best; what is known better takes the place of what was found before.
    center_m, radius_m = hips_m + _ABOVE_HIPS_M * up, np.full(track.num_frames, _OF_HIPS_M)
    ways = [
        (shoulders_m + _NECK_M * up, _OF_SHOULDERS_M),
        (shoulders_m + _NECK_BY_TRUNK * (shoulders_m - hips_m), _OF_TRUNK_M),
    ]
    face = [joints.index(name) for name in FACE if name in joints.names]
    if face:
        face_m = track.xyz_m[:, face]
        is_seen = np.isfinite(face_m).all(axis=-1)
        num_seen = is_seen.sum(axis=1, keepdims=True)
        total_m = np.where(is_seen[..., None], face_m, 0.0).sum(axis=1)
        ways.append((np.where(num_seen > 0, total_m / np.maximum(num_seen, 1), np.nan), _OF_FACE_M))
        ways.append((_middle(track, joints, "ear", both=True), _OF_EARS_M))
    for way_m, way_radius_m in ways:
        is_known = np.isfinite(way_m).all(axis=-1)
        center_m = np.where(is_known[:, None], way_m, center_m)
        radius_m = np.where(is_known, way_radius_m, radius_m)
    if face and track.uncertainty_m is not None:
        sigma_m = np.nan_to_num(track.uncertainty_m[:, face]).max(axis=1)
        radius_m = radius_m + np.minimum(_SIGMAS * sigma_m, _MAX_SIGMAS_M)
    return center_m, np.where(np.isfinite(center_m).all(axis=-1), radius_m, np.nan)


def _middle(track: Track3D, joints: JointSet, part: str, both: bool = False) -> Float[np.ndarray, "frames 3"]:
    """Middle between the left and the right joint of a part, or the only known one of them; else NaN.

    ``both``: NaN unless both are known.
    """
    names = [name for name in (f"left_{part}", f"right_{part}") if name in joints.names]
    if len(names) < 2:
        return np.full((track.num_frames, 3), np.nan)
    left_m, right_m = (track.xyz_m[:, joints.index(name)] for name in names)
    middle_m = (left_m + right_m) / 2
    if both:
        return middle_m
    middle_m = np.where(np.isfinite(middle_m), middle_m, left_m)
    return np.where(np.isfinite(middle_m), middle_m, right_m)
