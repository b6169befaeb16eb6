"""Figures of each person's observations in all cameras, for metrics, viewer files and reports.

Observations are the largest part of a take, and are read from its archive whenever they are asked for: once for all of
these figures.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.core.data.cameras import Camera
from pipeline.core.data.people import Observations, Track3D
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.joints import FINGER_JOINTS, JointSet
from pipeline.core.runtime import large_arrays
from pipeline.geometry.camera import project
from pipeline.motion.skeleton.marks import has_torso, marks_from_centers
from pipeline.motion.skeleton.time_series import windows

MIN_SCORE = 0.2
"""Lowest score of the observations that the figures include."""

# Instants at which cameras are compared, their least distance, and the lowest score of joints there.
_MAX_INSTANTS, _INDEPENDENT_S, _MIN_SAMPLED_SCORE = 60, 0.25, 0.3

PositionsOf = Callable[[slice], Float[np.ndarray, "rows joints 3"]]


@dataclass(frozen=True, slots=True, eq=False)
class PersonViews:
    """Figures of a person's observations. The observations are not kept, because they take most of the memory."""

    located: Track3D  # Joints located by association, without fingers
    error_px: Float[np.ndarray, "frames cameras joints"]  # See ``reprojection_error_px``
    sees: Bool[np.ndarray, "frames cameras"]  # True if a camera saw any joint of the person's body in a frame
    views_per_joint: float  # See ``views_per_joint``; without fingers
    instant: Int[np.ndarray, " instants"]  # Output frames of ``sampled_px``
    # Joints that the cameras see at instants with different errors of the detector; without fingers
    sampled_px: Float[np.ndarray, "instants cameras joints 2"]


def person_views(take: Reconstruction) -> tuple[PersonViews, ...]:
    """Figures of everybody's observations, in the order of the tracks."""
    return tuple(_compare(take, number) for number in range(len(take.tracks)))


GetViews = Callable[[Reconstruction], Sequence[PersonViews]]
"""``person_views``, or a function that keeps its result."""


def _compare(take: Reconstruction, number: int) -> PersonViews:
    track, observations, body = take.tracks[number], take.observations[number], body_joints(take.joints)
    error_px = reprojection_error_px(track, observations, take.cameras, _mark_positions(take, number))
    of_body = replace(observations, points_px=observations.points_px[:, :, body], score=observations.score[:, :, body])
    step = max(round(_INDEPENDENT_S * take.timebase.frame_rate_hz), take.timebase.num_frames // _MAX_INSTANTS, 1)
    rows = slice(-track.start_frame % step, None, step)
    points_px = np.where(of_body.score[rows][..., None] >= _MIN_SAMPLED_SCORE, of_body.points_px[rows], np.nan)
    return PersonViews(
        without_fingers(take.located[number], take.joints),
        error_px,
        np.asarray(_counts(of_body).any(-1)),
        views_per_joint(without_fingers(track, take.joints), of_body),
        np.arange(track.start_frame, track.start_frame + track.num_frames)[rows],
        points_px,
    )


def body_joints(joints: JointSet) -> slice:
    """Columns of the joints that belong to no finger; fingers are the last joints of every set that has them."""
    return slice(sum(name not in FINGER_JOINTS for name in joints.names))


def without_fingers(track: Track3D, joints: JointSet) -> Track3D:
    """Track of the joints that belong to no finger."""
    body = body_joints(joints)
    sigma_m = track.uncertainty_m
    return replace(
        track,
        xyz_m=track.xyz_m[:, body],
        score=track.score[:, body],
        source=track.source[:, body],
        error_px=track.error_px[:, body],
        views=track.views[:, body],
        uncertainty_m=None if sigma_m is None else sigma_m[:, body],
    )


def _mark_positions(take: Reconstruction, number: int) -> PositionsOf | None:
    """Positions of a person's marks; ``None`` if they are the joints' centres."""
    track, joints, offsets = take.tracks[number], take.joints, take.offsets
    # A person without hips and shoulders was fitted without offsets.
    if not offsets or not has_torso(track.xyz_m, joints):
        return None
    motion = take.motions[number]
    return lambda rows: marks_from_centers(track.xyz_m[rows], motion, rows, joints, offsets)


def has_position(track: Track3D) -> Bool[np.ndarray, "frames joints"]:
    """Mask of the joints with a position in each frame."""
    return np.isfinite(track.xyz_m).all(-1)


def _counts(observations: Observations) -> Bool[np.ndarray, "frames cameras joints"]:
    return (observations.score >= MIN_SCORE) & np.isfinite(observations.points_px).all(-1)


def reprojection_error_px(
    track: Track3D,
    observations: Observations,
    cameras: tuple[Camera, ...],
    marks_m: PositionsOf | None = None,
) -> Float[np.ndarray, "frames cameras joints"]:
    """Distance of each observation to the projection of the final position, in pixels of the full image.

    ``marks_m``: returns the positions in a range of frames that observations are compared with; ``None``: the final
    positions. Returns distances in single precision, to save memory. NaN where a camera has no observation with a
    sufficient score, and where the joint has no position or is behind the camera.
    """
    error_px = large_arrays.empty(observations.score.shape, np.float32)
    for rows in windows(track.num_frames, overlap=0):
        xyz_m = track.xyz_m[rows] if marks_m is None else marks_m(rows)
        for number, camera in enumerate(cameras):
            projected_px = project(camera, xyz_m)
            error_px[rows, number] = np.linalg.norm(projected_px - observations.points_px[rows, number], axis=-1)
        error_px[rows][~_counts(observations.part(rows))] = np.nan
    return error_px


def views_per_joint(track: Track3D, observations: Observations) -> float:
    """Mean number of observations with a sufficient score for a joint with a position; NaN without any."""
    num_views = _counts(observations).sum(1)[has_position(track)]
    return float(num_views.mean()) if len(num_views) else np.nan
