"""Positions of a person's joints over the whole track, from all that every view saw of them.

What is minimised, X being a joint at an instant, in metres:

- *rays*: for every observation with its score s, ``s^3 / sigma^2 GM(d; c)``, d the distance of X to the ray and GM
  the function of Geman and McClure, which no single wrong view can pull; its c shrinks from step to step (graduated
  non-convexity);
- *acceleration*: Cauchy's function of X's second difference over what a joint of its kind does. Heavy-tailed: a
  Gaussian prior would pull punches and jumps straight. It knows the frame rate;
- *bones*: the squared difference of a limb's length to the person's own, left and right pooled.

Where a view took a person's left limb for the right one, which fits clearly better exchanged, it is exchanged back.
Each step reweights and solves for one joint after the other with the others held: a banded system over time, so that
the cost is linear in the track's length. Long tracks are cut into windows that overlap.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import solveh_banded

from pipeline.data import Camera, Observations, Source, Timebase, Track3D, read_only
from pipeline.geometry.camera import center_in_world, rays_in_world
from pipeline.geometry.tracks import reproject
from pipeline.geometry.undistortion import undistort_px
from pipeline.joints import LIMBS, JointSet

# A detector's noise across a ray, and where c begins and ends.
_SIGMA_M = 0.015
_SCALES_M = (0.20, 0.12, 0.08, 0.05)
_NUM_STEPS = 12
_MIN_SCORE = 0.1
# What joints do in lively movement, m/s2; and how many times as much still counts as usual.
_USUAL_M_S2 = {
    "shoulder": 10.0, "elbow": 18.0, "wrist": 28.0, "hip": 8.0, "knee": 16.0, "ankle": 20.0, "toe": 24.0, "heel": 24.0,
    "neck": 10.0,
}  # fmt: skip
_USUAL_ELSE_M_S2 = 12.0
_HEAVY_TAIL = 3.0
# How much a limb's length differs between frames by what detectors mark.
_BONE_SIGMA_M = 0.010
_PREDICTED_FOR_S = 0.5
_WINDOW_FRAMES, _OVERLAP_FRAMES = 600, 60
# What detectors take for the other side's, how much better it must fit there (in observations of full score), and when
# this is looked at: where joints were located, and when they are about where they are.
_EXCHANGEABLE = (
    ("shoulder", "elbow", "wrist"), ("elbow", "wrist"), ("wrist",), ("hip", "knee", "ankle"), ("knee", "ankle"),
    ("ankle",),
)  # fmt: skip
_CLEARLY = 0.5
_STEPS_OF_EXCHANGE = (0, 3, 6)
# No joint moves farther in a step: rays that hardly cross say little of where along them it is.
_LONGEST_STEP_M = 0.3
# Holds a joint that nothing else holds where it is.
_INERTIA = 1e-2
# The second difference, and so how far its equations reach.
_DIFFERENCE = np.array([1.0, -2.0, 1.0])


def fit_tracks(
    tracks: Sequence[Track3D],
    observations: Sequence[Observations],
    cameras: Sequence[Camera],
    timebase: Timebase,
    joints: JointSet,
) -> tuple[Track3D, ...]:
    """Fit everybody's joints.

    Parameters
    ----------
    observations
        Behind the tracks, in their order.
    joints
        Of the tracks.

    Returns
    -------
        Tracks with other positions and reprojection errors. Where fewer than two views saw a joint, for up to half a
        second, it is predicted, and marked so; beyond it stays unknown.
    """
    return tuple(
        _fit_track(track, seen, cameras, timebase, joints) for track, seen in zip(tracks, observations, strict=True)
    )


def _fit_track(
    track: Track3D, seen: Observations, cameras: Sequence[Camera], timebase: Timebase, joints: JointSet
) -> Track3D:
    measured = track.source == Source.MEASURED
    limbs = _limbs(track, measured, joints)
    usual_m_s2 = np.array([_USUAL_M_S2.get(name.rpartition("_")[2], _USUAL_ELSE_M_S2) for name in joints.names])
    usual_m = usual_m_s2 / timebase.frame_rate_hz**2
    xyz_m = np.array(track.xyz_m)
    for rows, kept in _windows(track.num_frames):
        fitted_m = _fit_window(
            track.xyz_m[rows], seen.points_px[rows], seen.score[rows], cameras, limbs, usual_m, joints
        )
        xyz_m[kept] = fitted_m[kept.start - rows.start : kept.stop - rows.start]
    known = _within(measured, round(_PREDICTED_FOR_S * timebase.frame_rate_hz))
    xyz_m[~known] = np.nan
    error_px, _, _ = reproject(cameras, xyz_m, seen.points_px, seen.score)
    source = np.where(known, np.where(measured, Source.MEASURED, Source.PREDICTED), Source.ABSENT)
    return replace(
        track,
        xyz_m=read_only(xyz_m),
        source=read_only(source.astype(track.source.dtype)),
        error_px=read_only(error_px),
    )


def _windows(num_frames: int) -> Iterator[tuple[slice, slice]]:
    """Frames to fit at once, and those of them to keep."""
    step = _WINDOW_FRAMES - _OVERLAP_FRAMES
    borders = [*range(0, max(num_frames - _OVERLAP_FRAMES, 1), step), num_frames]
    for start, stop in pairwise(borders):
        around = slice(max(start - _OVERLAP_FRAMES // 2, 0), min(stop + _OVERLAP_FRAMES // 2, num_frames))
        yield around, slice(start, stop)


def _limbs(
    track: Track3D, measured: Bool[np.ndarray, "frames joints"], joints: JointSet
) -> list[list[tuple[int, float]]]:
    """The limbs that hang on each joint: the other end, and the person's length, left and right pooled."""
    pooled: dict[str, list[np.ndarray]] = {}
    ends = [(joints.index(one), joints.index(other)) for one, other in LIMBS if {one, other} <= set(joints.names)]
    for one, other in ends:
        both = measured[:, one] & measured[:, other]
        lengths_m = np.linalg.norm(track.xyz_m[both, one] - track.xyz_m[both, other], axis=-1)
        pooled.setdefault(joints.names[other].rpartition("_")[2], []).append(lengths_m)
    hanging: list[list[tuple[int, float]]] = [[] for _ in joints.names]
    for one, other in ends:
        lengths_m = np.concatenate(pooled[joints.names[other].rpartition("_")[2]])
        if len(lengths_m):
            length_m = float(np.median(lengths_m))
            hanging[one].append((other, length_m))
            hanging[other].append((one, length_m))
    return hanging


def _within(known: Bool[np.ndarray, "frames joints"], reach: int) -> Bool[np.ndarray, "frames joints"]:
    """Frames in gaps of at most twice ``reach`` and frames that close to a known one at the ends."""
    frames = np.arange(len(known))[:, None]
    last = np.maximum.accumulate(np.where(known, frames, -(10**9)), axis=0)
    following = np.minimum.accumulate(np.where(known, frames, 10**9)[::-1], axis=0)[::-1]
    return np.asarray(np.minimum(frames - last, following - frames) <= reach)


def _fit_window(
    start_m: Float[np.ndarray, "frames joints 3"],
    points_px: Float[np.ndarray, "frames cameras joints 2"],
    score: Float[np.ndarray, "frames cameras joints"],
    cameras: Sequence[Camera],
    limbs: Sequence[Sequence[tuple[int, float]]],
    usual_m: Float[np.ndarray, " joints"],
    joints: JointSet,
) -> Float[np.ndarray, "frames joints 3"]:
    xyz_m = _filled(start_m)
    centers_m = np.array([center_in_world(camera) for camera in cameras])
    rays = np.stack(
        [rays_in_world(camera, undistort_px(camera, points_px[:, k])) for k, camera in enumerate(cameras)], axis=1
    )
    is_seen = (score > _MIN_SCORE) & np.isfinite(rays).all(-1)
    rays = np.where(is_seen[..., None], rays, 0.0)
    weight = np.where(is_seen, score**3, 0.0) / _SIGMA_M**2
    across = np.eye(3) - rays[..., :, None] * rays[..., None, :]
    sides = [[tuple(f"{side}_{name}" for name in limb) for side in ("left", "right")] for limb in _EXCHANGEABLE]
    pairs = [
        (joints.indices(left), joints.indices(right)) for left, right in sides if {*left, *right} <= set(joints.names)
    ]
    # Of a joint that was never located there is nothing to fit.
    located = np.flatnonzero(np.isfinite(xyz_m[0, :, 0]))
    for step in range(_NUM_STEPS):
        scale_m2 = _SCALES_M[min(step, len(_SCALES_M) - 1)] ** 2
        if step in _STEPS_OF_EXCHANGE:
            for left, right in pairs:
                exchanged = _exchanged(xyz_m, centers_m, across, weight, left, right, scale_m2)
                for seen in (across, weight):
                    swapped = seen[:, :, [*right, *left]]
                    here = exchanged.reshape(*exchanged.shape, *(1,) * (seen.ndim - 2))
                    seen[:, :, [*left, *right]] = np.where(here, swapped, seen[:, :, [*left, *right]])
        for joint in located.tolist():
            off_m = np.einsum("fcab,fcb->fca", across[:, :, joint], xyz_m[:, None, joint] - centers_m)
            robust = weight[:, :, joint] * (scale_m2 / ((off_m**2).sum(-1) + scale_m2)) ** 2
            normal = np.einsum("fc,fcab->fab", robust, across[:, :, joint])
            right = np.einsum("fc,fcab,cb->fa", robust, across[:, :, joint], centers_m)
            for other, length_m in limbs[joint] if step > 0 else ():
                _add_bone(normal, right, xyz_m[:, joint], xyz_m[:, other], length_m)
            step_m = _solve(normal, right, xyz_m[:, joint], usual_m[joint]) - xyz_m[:, joint]
            length_m = np.linalg.norm(step_m, axis=-1, keepdims=True)
            xyz_m[:, joint] += step_m * np.minimum(1.0, _LONGEST_STEP_M / np.maximum(length_m, 1e-9))
    return xyz_m


def _exchanged(
    xyz_m: Float[np.ndarray, "frames joints 3"],
    centers_m: Float[np.ndarray, "cameras 3"],
    across: Float[np.ndarray, "frames cameras joints 3 3"],
    weight: Float[np.ndarray, "frames cameras joints"],
    left: list[int],
    right: list[int],
    scale_m2: float,
) -> Bool[np.ndarray, "frames cameras"]:
    """Where a view's left limb fits the right one and the other way round, clearly better than as they are."""

    def cost(of: list[int], seen_as: list[int]) -> Float[np.ndarray, "frames cameras"]:
        from_center_m = xyz_m[:, None, of] - centers_m[:, None]
        off_m2 = (np.einsum("fcjab,fcjb->fcja", across[:, :, seen_as], from_center_m) ** 2).sum(-1)
        lost = weight[:, :, seen_as] * _SIGMA_M**2 * off_m2 / (off_m2 + scale_m2)
        return np.asarray(np.nan_to_num(lost).sum(-1))

    both, other_way = [*left, *right], [*right, *left]
    return cost(both, both) - cost(both, other_way) > _CLEARLY


def _filled(xyz_m: Float[np.ndarray, "frames joints 3"]) -> Float[np.ndarray, "frames joints 3"]:
    """Linear over gaps, held at the ends; NaN for what was never known."""
    filled = np.array(xyz_m)
    frames = np.arange(len(xyz_m))
    for joint in range(xyz_m.shape[1]):
        known = np.flatnonzero(np.isfinite(xyz_m[:, joint]).all(-1))
        if len(known):
            for axis in range(3):
                filled[:, joint, axis] = np.interp(frames, known, xyz_m[known, joint, axis])
    return filled


def _add_bone(
    normal: Float[np.ndarray, "frames 3 3"],
    right: Float[np.ndarray, "frames 3"],
    here_m: Float[np.ndarray, "frames 3"],
    other_m: Float[np.ndarray, "frames 3"],
    length_m: float,
) -> None:
    """Newton's step for a limb's length, in place; nothing where the other end is unknown or in the same place.

    Across the limb its curvature is kept where it is positive: without, a joint that little else holds would fly off.
    """
    along_m = here_m - other_m
    distance_m = np.linalg.norm(along_m, axis=-1)
    usable = distance_m > 1e-3
    distance_m = np.where(usable, distance_m, 1.0)
    unit = np.where(usable[:, None], along_m / distance_m[:, None], 0.0)
    across = np.where(usable, np.maximum(1.0 - length_m / distance_m, 0.0), 0.0)
    outer = unit[:, :, None] * unit[:, None, :]
    curvature = (outer + across[:, None, None] * (np.eye(3) - outer)) / _BONE_SIGMA_M**2
    pull = np.where(usable, distance_m - length_m, 0.0)[:, None] * unit / _BONE_SIGMA_M**2
    normal += curvature
    right += (curvature @ here_m[..., None])[..., 0] - pull


def _solve(
    normal: Float[np.ndarray, "frames 3 3"],
    right: Float[np.ndarray, "frames 3"],
    before_m: Float[np.ndarray, "frames 3"],
    usual_m: float,
) -> Float[np.ndarray, "frames 3"]:
    """One joint over time: the frames' own equations, and the acceleration that ties them."""
    num_frames = len(normal)
    # Row d of a banded matrix holds its d-th upper diagonal, at the column of the later unknown.
    banded = np.zeros((9, num_frames, 3))
    for row in range(3):
        for column in range(row, 3):
            banded[8 - (column - row), :, column] += normal[:, row, column]
    banded[8] += _INERTIA
    if num_frames > 2:
        second_m = before_m[2:] - 2 * before_m[1:-1] + before_m[:-2]
        ratio2 = (second_m**2).sum(-1) / usual_m**2
        tie = 1.0 / (usual_m**2 * (1.0 + ratio2 / _HEAVY_TAIL**2))
        for one in range(3):
            for other in range(one, 3):
                tied = slice(other, num_frames - 2 + other)
                banded[8 - 3 * (other - one), tied] += (_DIFFERENCE[one] * _DIFFERENCE[other] * tie)[:, None]
    solved: np.ndarray = solveh_banded(
        banded.reshape(9, -1), (right + _INERTIA * before_m).ravel(), overwrite_ab=True, check_finite=False
    )
    return solved.reshape(-1, 3)
