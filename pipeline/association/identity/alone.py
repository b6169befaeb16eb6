"""People seen by one camera alone, beyond the first and the last frame in which two cameras located them.

One camera does not tell the distance. But for a while the motion is predictable: the body continues from its last
place, and its joints are on the rays of the camera, about as far away as before. These places are predictions; the fit
adjusts them to the ray, to the lengths of the bones and to the motion before.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from pipeline.association.identity.recover_detections import MIN_JOINTS, mean_distance_m
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera, Timebase
from pipeline.core.data.people import Leftovers, Source, Track3D
from pipeline.core.runtime import large_arrays
from pipeline.geometry.camera import center_in_world, rays_in_world
from pipeline.geometry.track_assembly import Person
from pipeline.geometry.tracks import reproject
from pipeline.geometry.undistortion import undistort_px

# Longest time for which one camera alone is followed, and longest time without any body in it.
_LONGEST_S, _LONGEST_GAP_S = 1.0, 0.2
# Time over which places and speed at the end of a track are taken, and time for which the speed is kept.
_RECENT_S, _GOES_ON_S = 0.2, 0.25
# Largest mean distance of a body's joints from the expected ones, at the person's distance.
_REACH_M = 0.2
# Bodies that lie nearer to an observation of a person, as a share of the diagonal of the box around it, are theirs.
_SAME_SHARE = 0.05


def follow_alone(
    persons: Sequence[Person], left: Leftovers, cameras: Sequence[Camera], timebase: Timebase, min_score: float
) -> list[Person]:
    """Continue tracks by bodies that one camera sees, for up to a second before and behind.

    ``left`` are bodies without a person after association. Observations with a score below ``min_score`` are not used.
    Joints of the frames that are added have the source ``PREDICTED``.
    """
    is_free = _is_without_person(left, persons)
    free = np.flatnonzero(is_free)
    in_time = free[np.argsort(left.frame[free], kind="stable")]
    borders = np.searchsorted(left.frame[in_time], np.arange(timebase.num_frames + 1))

    def bodies_at(frame: int) -> list[int]:
        return [row for row in in_time[borders[frame] : borders[frame + 1]].tolist() if is_free[row]]

    followed = list(persons)
    setting = left, bodies_at, is_free, cameras, timebase, min_score
    for step in (1, -1):
        followed = [_follow(person, step, *setting) for person in followed]
    return followed


def _follow(
    person: Person,
    step: int,
    left: Leftovers,
    bodies_at: Callable[[int], Sequence[int]],
    is_free: Bool[np.ndarray, " bodies"],
    cameras: Sequence[Camera],
    timebase: Timebase,
    min_score: float,
) -> Person:
    """Continue a track behind its last frame (``step`` 1) or before its first one (-1); claims the bodies it takes."""
    track, _ = person
    rate_hz = timebase.frame_rate_hz
    body_m, velocity_m = _track_end(track, step, rate_hz)
    end = track.start_frame + (track.num_frames - 1 if step > 0 else 0)
    bodies: list[tuple[int, int, Float[np.ndarray, "joints 3"]]] = []
    last_found = 0
    for number in range(1, int(_LONGEST_S * rate_hz) + 1):
        frame = end + step * number
        if not 0 <= frame < timebase.num_frames or number - last_found > max(1.0, _LONGEST_GAP_S * rate_hz):
            break
        if number <= _GOES_ON_S * rate_hz:
            body_m = body_m + velocity_m
        found = _nearest(body_m, bodies_at(frame), left, cameras, min_score)
        if found is None:
            continue
        body_m = _on_rays(body_m, cameras[left.camera[found]], left.points_px[found], left.score[found] >= min_score)
        is_free[found] = False
        bodies.append((number, found, body_m))
        last_found = number
    return _longer(person, step, bodies, left, cameras, min_score) if bodies else person


def _track_end(
    track: Track3D, step: int, rate_hz: float
) -> tuple[Float[np.ndarray, "joints 3"], Float[np.ndarray, " 3"]]:
    """Joints at an end of a track in metres, NaN where they are unknown, and the body's way from frame to frame.

    A joint that is unknown at the end itself is where it was shortly before, moved with the body.
    """
    recent = max(2, round(_RECENT_S * rate_hz))
    places_m = track.xyz_m[::-1][:recent] if step > 0 else track.xyz_m[:recent]
    steps_m = np.diff(places_m[::-1], axis=0)
    known = np.isfinite(steps_m).all(-1)
    velocity_m = np.median(steps_m[known], axis=0) if known.any() else np.zeros(3)
    body_m = places_m[0]
    for ago in range(1, len(places_m)):
        body_m = np.where(np.isfinite(body_m), body_m, places_m[ago] + ago * velocity_m)
    return body_m, velocity_m


def _nearest(
    body_m: Float[np.ndarray, "joints 3"],
    rows: Sequence[int],
    left: Leftovers,
    cameras: Sequence[Camera],
    min_score: float,
) -> int | None:
    """Row of the body that is nearest to the expected joints; ``None`` if none is near."""
    nearest, nearest_m = None, _REACH_M
    for row in rows:
        seen_px = np.where((left.score[row] >= min_score)[:, None], left.points_px[row], np.nan)
        apart_m = float(mean_distance_m(cameras[left.camera[row]], body_m[None], seen_px[None])[0])
        if apart_m < nearest_m:
            nearest, nearest_m = row, apart_m
    return nearest


def _on_rays(
    body_m: Float[np.ndarray, "joints 3"],
    camera: Camera,
    points_px: Float[np.ndarray, "joints 2"],
    is_seen: Bool[np.ndarray, " joints"],
) -> Float[np.ndarray, "joints 3"]:
    """Joints moved to the nearest points of their rays; those without a ray move with the others."""
    ray = rays_in_world(camera, undistort_px(camera, points_px))
    from_camera_m = body_m - center_in_world(camera)
    moved_m = (from_camera_m * ray).sum(-1, keepdims=True) * ray - from_camera_m
    has_ray = np.isfinite(moved_m).all(-1) & is_seen
    return body_m + np.where(has_ray[:, None], moved_m, np.median(moved_m[has_ray], axis=0))


def _longer(
    person: Person,
    step: int,
    bodies: Sequence[tuple[int, int, Float[np.ndarray, "joints 3"]]],
    left: Leftovers,
    cameras: Sequence[Camera],
    min_score: float,
) -> Person:
    """Person with more frames at an end; places between two bodies are on straight lines."""
    track, seen = person
    numbers = [number for number, _, _ in bodies]
    num_added, num_joints = numbers[-1], track.xyz_m.shape[1]
    first_m = track.xyz_m[-1 if step > 0 else 0]
    first_m = np.where(np.isfinite(first_m), first_m, bodies[0][2])
    known_m = np.stack([first_m, *(body_m for _, _, body_m in bodies)]).reshape(len(bodies) + 1, -1)
    rows = np.arange(1, num_added + 1)
    columns = [np.interp(rows, [0, *numbers], column_m) for column_m in known_m.T]
    xyz_m = np.stack(columns, axis=-1).reshape(num_added, num_joints, 3)
    points_px = np.full((num_added, len(cameras), num_joints, 2), np.nan)
    score = np.zeros(points_px.shape[:-1])
    for number, row, _ in bodies:
        points_px[number - 1, left.camera[row]], score[number - 1, left.camera[row]] = (
            left.points_px[row],
            left.score[row],
        )
    source = np.where(np.isfinite(xyz_m).all(-1), Source.PREDICTED, Source.ABSENT).astype(track.source.dtype)
    error_px, mean_score, views = reproject(cameras, xyz_m, points_px, score, min_score)

    def joined(before: np.ndarray, added: np.ndarray) -> np.ndarray:
        return read_only(large_arrays.concatenate([before, added] if step > 0 else [added[::-1], before]))

    longer = replace(
        track,
        start_frame=track.start_frame if step > 0 else track.start_frame - num_added,
        xyz_m=joined(track.xyz_m, xyz_m),
        score=joined(track.score, mean_score),
        source=joined(track.source, source),
        error_px=joined(track.error_px, error_px),
        views=joined(track.views, views),
    )
    observed = replace(seen, points_px=joined(seen.points_px, points_px), score=joined(seen.score, score))
    return longer, observed


def _is_without_person(left: Leftovers, persons: Sequence[Person]) -> Bool[np.ndarray, " bodies"]:
    """Bodies that are no observation of anybody, nor a second detection of one."""
    is_free = np.ones(len(left.frame), bool)
    for track, seen in persons:
        row = left.frame - track.start_frame
        inside = np.flatnonzero((row >= 0) & (row < track.num_frames))
        for block in large_arrays.blocks(len(inside)):
            bodies = inside[block]
            theirs_px = seen.points_px[row[bodies], left.camera[bodies]]
            is_free[bodies] &= ~_alike(theirs_px, left.points_px[bodies])
    return is_free


def _alike(
    theirs_px: Float[np.ndarray, "n joints 2"], bodies_px: Float[np.ndarray, "n joints 2"]
) -> Bool[np.ndarray, " n"]:
    """Bodies whose joints are on average where an observation's joints are, for its size."""
    known = np.isfinite(theirs_px)
    size_px = np.where(known, theirs_px, -np.inf).max(1, initial=-np.inf) - np.where(known, theirs_px, np.inf).min(1)
    limit_px = _SAME_SHARE * np.linalg.norm(np.maximum(size_px, 0.0), axis=-1)
    apart_px = np.linalg.norm(theirs_px - bodies_px, axis=-1)
    both = np.isfinite(apart_px)
    mean_px = np.where(both, apart_px, 0.0).sum(-1) / np.maximum(both.sum(-1), 1)
    return np.asarray((both.sum(-1) >= MIN_JOINTS) & (mean_px <= limit_px))
