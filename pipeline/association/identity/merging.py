"""Pieces of tracks, and one track of a person's pieces."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from pipeline.core.data.cameras import Camera, Timebase
from pipeline.core.data.people import Source
from pipeline.geometry.camera import projection_matrices
from pipeline.geometry.track_assembly import Person, record_life
from pipeline.geometry.tracks import triangulate_frames
from pipeline.geometry.undistortion import undistort_views

# Frames around an overlap that help to settle disputes between views; see ``triangulate_frames``.
_REACH = 2


def cut(person: Person, start_frame: int, stop_frame: int) -> Person:
    """Some frames of a person; the person itself if these are all."""
    track, seen = person
    rows = slice(start_frame - track.start_frame, stop_frame - track.start_frame)
    if rows == slice(0, track.num_frames):
        return person
    piece = replace(
        track,
        start_frame=start_frame,
        **{name: getattr(track, name)[rows] for name in ("xyz_m", "score", "source", "error_px", "views")},
    )
    return piece, replace(seen, points_px=seen.points_px[rows], score=seen.score[rows], detection=seen.detection[rows])


def merge(pieces: Sequence[Person], cameras: Sequence[Camera], timebase: Timebase, min_score: float) -> Person | None:
    """Merge pieces of one person to a track.

    Where pieces overlap, each camera counts once, for the piece that was observed more often, and joints are
    triangulated again from the observations of all pieces. Observations with a score below ``min_score`` are not used.
    Returns the piece itself if there is only one, ``None`` if nothing is long enough.
    """
    if len(pieces) == 1:
        return pieces[0]
    start = min(track.start_frame for track, _ in pieces)
    stop = max(track.start_frame + track.num_frames for track, _ in pieces)
    _, first = pieces[0]
    shape = (stop - start, *first.score.shape[1:])
    xyz_m = np.full((shape[0], shape[2], 3), np.nan)
    points_px, score = np.full((*shape, 2), np.nan), np.zeros(shape)
    detection = np.full(shape[:2], -1) if all(len(seen.detection) for _, seen in pieces) else None
    num_pieces = np.zeros(shape[0], int)
    for track, seen in sorted(pieces, key=lambda piece: -np.count_nonzero(piece[1].score)):
        rows = slice(track.start_frame - start, track.start_frame - start + track.num_frames)
        free = np.asarray((score[rows] <= 0).all(-1, keepdims=True))
        points_px[rows] = np.where(free[..., None], seen.points_px, points_px[rows])
        score[rows] = np.where(free, seen.score, score[rows])
        if detection is not None:
            detection[rows] = np.where(free[..., 0], seen.detection, detection[rows])
        measured_m = np.where((track.source == Source.MEASURED)[..., None], track.xyz_m, np.nan)
        xyz_m[rows] = np.where(num_pieces[rows, None, None] == 0, measured_m, xyz_m[rows])
        num_pieces[rows] += np.isfinite(track.xyz_m[..., 0]).any(-1)
    _locate(xyz_m, points_px, score, np.asarray(num_pieces > 1), cameras, min_score)
    return record_life(cameras, timebase, start, xyz_m, points_px, score, min_score, detection)


def relocate(
    person: Person,
    changed: Bool[np.ndarray, " frames"],
    cameras: Sequence[Camera],
    timebase: Timebase,
    min_score: float,
) -> Person:
    """Locate a person's joints again in frames whose observations have changed."""
    track, seen = person
    xyz_m = np.where((track.source == Source.MEASURED)[..., None], track.xyz_m, np.nan)
    _locate(xyz_m, seen.points_px, seen.score, changed, cameras, min_score)
    detection = seen.detection if len(seen.detection) else None
    located = record_life(cameras, timebase, track.start_frame, xyz_m, seen.points_px, seen.score, min_score, detection)
    return person if located is None else located


def _locate(
    xyz_m: Float[np.ndarray, "frames joints 3"],
    points_px: Float[np.ndarray, "frames cameras joints 2"],
    score: Float[np.ndarray, "frames cameras joints"],
    chosen: Bool[np.ndarray, " frames"],
    cameras: Sequence[Camera],
    min_score: float,
) -> None:
    """Triangulate the joints of the chosen frames, in place."""
    for rows in runs(chosen):
        xyz_m[rows] = _triangulate(cameras, points_px, score, rows, min_score)


def _triangulate(
    cameras: Sequence[Camera],
    points_px: Float[np.ndarray, "frames cameras joints 2"],
    score: Float[np.ndarray, "frames cameras joints"],
    rows: slice,
    min_score: float,
) -> Float[np.ndarray, "rows joints 3"]:
    first = max(0, rows.start - _REACH)
    around = slice(first, rows.stop + _REACH)
    ideal_px = undistort_views(cameras, points_px[around])
    xyz_m = triangulate_frames(projection_matrices(cameras), ideal_px, score[around], min_score)
    return xyz_m[rows.start - first : rows.stop - first]


def runs(chosen: Bool[np.ndarray, " n"]) -> list[slice]:
    """Slices of consecutive chosen rows."""
    borders = np.flatnonzero(np.diff(np.concatenate([[False], chosen, [False]]))).tolist()
    return [slice(first, last) for first, last in zip(borders[::2], borders[1::2], strict=True)]
