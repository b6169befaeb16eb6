"""Poses of instants without likenesses: poses are linked from instant to instant, as far as that tells who moves."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import linear_sum_assignment

from pipeline.association.identity.likenesses.find import find_likenesses
from pipeline.core.data.cameras import Camera, Timebase
from pipeline.core.data.people import Poses3D, Source, Track3D
from pipeline.core.joints import JointSet

# Farthest way of a body from one instant to the next one, and longest absence.
_REACH_M, _ABSENT_S = 0.6, 2.0


def without_likenesses(
    poses: Sequence[Poses3D], cameras: Sequence[Camera], joints: JointSet, timebase: Timebase, step: int
) -> list[Poses3D]:
    """Leave out the poses of those who never move and of mirror images; all stay if nobody else is left.

    ``poses`` are parts of a take at every ``step``-th output frame, in any order, such as one a person.
    """
    frame = np.concatenate([np.zeros(0, int), *(some.frame for some in poses)])
    if not len(frame):
        return list(poses)
    xyz_m = np.concatenate([some.xyz_m for some in poses])
    sees = np.concatenate([np.isfinite(some.points_px[..., 0]).any(1) for some in poses])
    rate_hz = timebase.frame_rate_hz / step
    chains = _link(frame, xyz_m, round(_ABSENT_S * timebase.frame_rate_hz))
    tracks = [_track_of(frame[rows] // step, xyz_m[rows]) for rows in chains]

    def sees_in(number: int) -> np.ndarray:
        return np.asarray(sees[chains[number]])

    likenesses = find_likenesses(tracks, sees_in, cameras, joints, rate_hz)
    kept = np.zeros(len(frame), bool)
    for number in likenesses.others(len(chains)):
        kept[chains[number]] = True
    parts = np.split(kept, np.cumsum([len(some.frame) for some in poses])[:-1])
    return [
        replace(
            some,
            **{name: getattr(some, name)[chosen] for name in ("frame", "xyz_m", "points_px", "score")},
        )
        for some, chosen in zip(poses, parts, strict=True)
    ]


def _link(
    frame: Int[np.ndarray, " poses"], xyz_m: Float[np.ndarray, "poses joints 3"], longest_absence: int
) -> list[Int[np.ndarray, " rows"]]:
    """Rows of the poses of each body, in order of time: each pose goes to the nearest body of the instants before."""
    place_m = _middle_m(xyz_m)
    chains: list[list[int]] = []
    for now in np.unique(frame):
        rows = np.flatnonzero((frame == now) & np.isfinite(place_m[:, 0]))
        alive = [chain for chain in chains if now - frame[chain[-1]] <= longest_absence]
        last_m = np.array([place_m[chain[-1]] for chain in alive]).reshape(-1, 3)
        away_m = np.linalg.norm(last_m[:, None] - place_m[rows][None], axis=-1)
        taken = set()
        for chain, column in zip(*linear_sum_assignment(np.minimum(away_m, 2 * _REACH_M)), strict=True):
            if away_m[chain, column] <= _REACH_M:
                alive[chain].append(int(rows[column]))
                taken.add(int(column))
        chains += [[int(row)] for column, row in enumerate(rows) if column not in taken]
    return [np.array(chain) for chain in chains]


def _middle_m(xyz_m: Float[np.ndarray, "poses joints 3"]) -> Float[np.ndarray, "poses 3"]:
    """Median of the known joints of each pose; NaN without any."""
    middle_m = np.full((len(xyz_m), 3), np.nan)
    known = np.isfinite(xyz_m[..., 0]).any(-1)
    if known.any():
        middle_m[known] = np.nanmedian(xyz_m[known], axis=1)
    return middle_m


def _track_of(instant: Int[np.ndarray, " rows"], xyz_m: Float[np.ndarray, "rows joints 3"]) -> Track3D:
    """Track of the poses of one body, by instants."""
    num = int(instant[-1] - instant[0]) + 1
    all_m = np.full((num, *xyz_m.shape[1:]), np.nan)
    all_m[instant - instant[0]] = xyz_m
    known = np.isfinite(all_m[..., 0])
    return Track3D(
        0,
        int(instant[0]),
        all_m,
        known.astype(np.float64),
        np.where(known, Source.MEASURED, Source.ABSENT),
        np.where(known, 0.0, np.nan),
        known.astype(int),
    )
