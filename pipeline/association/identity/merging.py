"""Pieces of tracks, one track of a person's pieces, and tracks that are at the same time of the same person.

One person is in one place at one time, and has one body in each picture. So two tracks are of one person if they are at
the same place while hardly any picture shows both of them.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from pipeline.association.identity.tracklets import Path, make_path, pairs_within
from pipeline.core.data.arrays import mean_known
from pipeline.core.data.cameras import Camera, Timebase
from pipeline.core.joints import JointSet
from pipeline.core.runtime import large_arrays
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
    xyz_m = large_arrays.full((shape[0], shape[2], 3), np.nan)
    points_px, score = large_arrays.full((*shape, 2), np.nan), large_arrays.full(shape, 0.0)
    detection = np.full(shape[:2], -1) if all(len(seen.detection) for _, seen in pieces) else None
    num_pieces = np.zeros(shape[0], int)
    for track, seen in sorted(pieces, key=lambda piece: -np.count_nonzero(piece[1].score)):
        rows = slice(track.start_frame - start, track.start_frame - start + track.num_frames)
        free = np.asarray((score[rows] <= 0).all(-1, keepdims=True))
        np.copyto(points_px[rows], seen.points_px, where=free[..., None])
        np.copyto(score[rows], seen.score, where=free)
        if detection is not None:
            detection[rows] = np.where(free[..., 0], seen.detection, detection[rows])
        np.copyto(xyz_m[rows], track.copy_measured(), where=num_pieces[rows, None, None] == 0)
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
    xyz_m = track.copy_measured()
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
    for run in runs(chosen):
        for block in large_arrays.blocks(run.stop - run.start):
            start, stop = run.start + block.start, run.start + block.stop
            first = max(0, start - _REACH)
            ideal_px = undistort_views(cameras, points_px[first : stop + _REACH])
            seen = ideal_px, score[first : stop + _REACH]
            located_m = triangulate_frames(projection_matrices(cameras), *seen, min_score)
            xyz_m[start:stop] = located_m[start - first : stop - first]


def runs(chosen: Bool[np.ndarray, " n"]) -> list[slice]:
    """Slices of consecutive chosen rows."""
    borders = np.flatnonzero(np.diff(np.concatenate([[False], chosen, [False]]))).tolist()
    return [slice(first, last) for first, last in zip(borders[::2], borders[1::2], strict=True)]


# Median distance of the trunks of one person's tracks, and share of the pictures of one that show the other as well.
_SAME_PLACE_M, _BOTH_SEEN = 0.35, 0.2
# Bodies in a picture are one body, found twice, if they differ by less than this share of their height.
_TWICE = 0.15
_MIN_JOINTS = 3


def merge_doubles(
    pieces: Sequence[Person], cameras: Sequence[Camera], joints: JointSet, timebase: Timebase, min_score: float
) -> list[Person]:
    """Merge pieces of tracks that are at the same time of the same person.

    The pieces have no long gaps; ``min_score`` is explained by ``merge``.
    """
    paths = [make_path(track, joints) for track, _ in pieces]
    shared = {
        (first, second): min(paths[first].stop_frame, paths[second].stop_frame) - paths[second].start_frame
        for first, second in pairs_within(paths, _SAME_PLACE_M)
        if _is_same_place(paths[first], paths[second]) and _is_one_body(pieces[first], pieces[second])
    }

    def may_be_one(first: int, second: int) -> bool:
        is_apart_in_time = (
            paths[first].stop_frame <= paths[second].start_frame or paths[second].stop_frame <= paths[first].start_frame
        )
        return is_apart_in_time or (min(first, second), max(first, second)) in shared

    group = {number: [number] for number in range(len(pieces))}
    for first, second in sorted(shared, key=lambda pair: (-shared[pair], pair)):
        left, right = group[first], group[second]
        # A track near two people must not make one person of them.
        if left is not right and all(may_be_one(a, b) for a in left for b in right):
            left += right
            group |= dict.fromkeys(right, left)
    groups = {id(members): members for members in group.values()}.values()
    merged = (merge([pieces[number] for number in sorted(members)], cameras, timebase, min_score) for members in groups)
    return [person for person in merged if person is not None]


def _is_same_place(first: Path, second: Path) -> bool:
    frames = np.arange(max(first.start_frame, second.start_frame), min(first.stop_frame, second.stop_frame))
    apart_m = np.linalg.norm(first.at(frames) - second.at(frames), axis=-1)
    apart_m = apart_m[np.isfinite(apart_m)]
    return len(apart_m) > 0 and float(np.median(apart_m)) < _SAME_PLACE_M


def _is_one_body(first: Person, second: Person) -> bool:
    start = max(first[0].start_frame, second[0].start_frame)
    stop = min(track.start_frame + track.num_frames for track, _ in (first, second))
    seen = [slice(start - track.start_frame, stop - track.start_frame) for track, _ in (first, second)]
    points_px = [person[1].points_px[rows] for person, rows in zip((first, second), seen, strict=True)]
    is_found = [np.isfinite(of_person_px[..., 0]) for of_person_px in points_px]
    pictures = [of_person.sum(-1) >= _MIN_JOINTS for of_person in is_found]
    both = pictures[0] & pictures[1]
    both &= ~_is_found_twice(points_px[0], points_px[1])
    return bool(both.sum() <= _BOTH_SEEN * min(of_person.sum() for of_person in pictures))


def _is_found_twice(
    one_px: Float[np.ndarray, "frames cameras joints 2"], other_px: Float[np.ndarray, "frames cameras joints 2"]
) -> Bool[np.ndarray, "frames cameras"]:
    """True if two detected bodies of a picture are nearly the same."""
    with np.errstate(invalid="ignore"):
        apart_px = mean_known(np.linalg.norm(one_px - other_px, axis=-1), -1)
        height_px = np.fmax.reduce(one_px[..., 1], axis=-1) - np.fmin.reduce(one_px[..., 1], axis=-1)
        return apart_px < _TWICE * height_px
