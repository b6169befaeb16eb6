"""Tracks that are at the same time of the same person.

One person is in one place at one time, and has one body in each picture. So two tracks are of one person if they are at
the same place while hardly any picture shows both of them.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from pipeline.association.identity.merging import merge
from pipeline.association.identity.tracklets import Path, pairs_within, path_of
from pipeline.core.data.cameras import Camera, Timebase
from pipeline.core.joints import JointSet
from pipeline.geometry.track_assembly import Person

# Median distance of the trunks of one person's tracks, and share of the pictures of one that show the other as well.
_SAME_PLACE_M, _BOTH_SEEN = 0.35, 0.2
# Bodies in a picture are one body, found twice, if they differ by less than this share of their height.
_TWICE = 0.15
_MIN_JOINTS = 3


def merge_doubles(
    pieces: Sequence[Person], cameras: Sequence[Camera], joints: JointSet, timebase: Timebase, min_score: float
) -> list[Person]:
    """Merge pieces of tracks that are at the same time of the same person.

    The pieces have no long gaps; ``min_score`` is as of ``merging.merge``.
    """
    paths = [path_of(track, joints) for track, _ in pieces]
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
    """Whether two detected bodies of a picture are nearly the same."""
    with np.errstate(invalid="ignore"):
        apart_px = _mean(np.linalg.norm(one_px - other_px, axis=-1))
        height_px = np.fmax.reduce(one_px[..., 1], axis=-1) - np.fmin.reduce(one_px[..., 1], axis=-1)
        return apart_px < _TWICE * height_px


def _mean(values: Float[np.ndarray, "*batch joints"]) -> Float[np.ndarray, "*batch"]:
    """Mean of the values that are not NaN, NaN without any."""
    known = np.isfinite(values)
    count = known.sum(-1)
    return np.asarray(np.where(known, values, 0.0).sum(-1) / np.where(count, count, np.nan))
