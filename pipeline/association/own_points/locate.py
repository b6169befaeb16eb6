"""Locate points of the user's own in the world: points that belong to people, and objects.

A point belongs to people if it is listed with their joints and stays near them, or if it is listed with no person and
stays near a single one. Other points are objects, such as a ball that is listed with the player: of each picture the
detection with the highest score counts.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Int

from pipeline.association.own_points.animals import track_animals
from pipeline.association.own_points.triangulate_points import locate_points
from pipeline.association.tracking.observations import Detections2D, gather, observed_by
from pipeline.association.tracking.tracking_parameters import TrackingParameters
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera, FrameTimes, Timebase
from pipeline.core.data.detections import Detections
from pipeline.core.data.own_points import OwnDetections, OwnTracks, SceneObject
from pipeline.core.data.people import Observations, Track3D
from pipeline.core.joints import JointSet, other_side

# A row of a file is a person's if the middle difference of its joints is at most this share of the diagonal of its box:
# between two output frames a body moves, and other rows are other people.
_MAX_APART = 0.25
# A point stays near a person if a joint is that near in so many frames: the reach of a racket, or of an arm.
_NEAR_M, _NEAR_SHARE = 1.2, 0.95


def locate_own_points(
    cameras: Sequence[Camera],
    times: Mapping[str, FrameTimes],
    timebase: Timebase,
    detections: Mapping[str, Detections],
    own: OwnDetections,
    joints: JointSet,
    tracks: Sequence[Track3D],
    observations: Sequence[Observations],
    parameters: TrackingParameters,
) -> OwnTracks:
    """Locate own points by robust triangulation.

    Parameters
    ----------
    detections, joints
        Bodies by camera with joints in distorted pixels, NaN where a joint was not found.
    own
        Own points of these bodies and of the scene.
    tracks, observations
        People in the world (metres), and their observations in the same frames.

    Returns
    -------
        Points of people in the frames of their tracks, and objects in all frames. Positions are NaN where fewer than
        two views agree within 6 cm, and interpolated in gaps of at most 0.2 s. Standard deviations are in metres, root
        mean square over the axes.
    """
    bodies, of_bodies, of_scene = (gather(cameras, times, some) for some in (detections, own.of_bodies, own.of_scene))
    animals = track_animals(cameras, times, timebase, own)

    def located(track: Track3D, points: Detections2D, rows: Int[np.ndarray, " rows"]) -> Track3D:
        seen = observed_by(track, points, rows, len(cameras), timebase, parameters.lambda_t_hz)
        return locate_points(cameras, timebase, track, *seen, parameters.min_score)

    best = _best_of_frames(of_bodies, of_scene)
    shape = timebase.num_frames, 0
    everywhere = Track3D(0, 0, np.empty((*shape, 3)), *(np.empty(shape) for _ in range(4)))
    scene = located(everywhere, best, np.arange(len(best.frame)))
    of_people = [
        located(track, of_bodies, _rows_of(bodies, seen, track, timebase, joints))
        for track, seen in zip(tracks, observations, strict=True)
    ]
    with_bodies = np.isfinite(of_bodies.seen_px).any((0, 2))
    is_persons = with_bodies & _stay_near(zip(of_people, tracks, strict=True), len(own.names))
    for k in np.flatnonzero(~with_bodies).tolist():
        of_k = _columns(scene, [k])
        near = [number for number, track in enumerate(tracks) if _stay_near([(of_k, track)], 1)[0]]
        if len(near) == 1:
            person = near[0]
            is_persons[k] = True
            of_people[person] = _with_column(of_people[person], k, _in_frames(of_k, tracks[person].frames))
    columns = np.flatnonzero(is_persons).tolist()
    return OwnTracks(
        tuple(own.names[k] for k in columns),
        tuple(_columns(points, columns) for points in of_people),
        tuple(
            SceneObject(name, (name,), _columns(scene, [k]))
            for k, name in enumerate(own.names)
            if not is_persons[k] and np.isfinite(scene.xyz_m[:, k]).any()
        )
        + animals,
    )


def _rows_of(
    bodies: Detections2D, seen: Observations, track: Track3D, timebase: Timebase, joints: JointSet
) -> Int[np.ndarray, " rows"]:
    """Rows of a person's bodies, ascending, at most one a camera and frame: the nearest to the observations."""
    frame = np.rint((bodies.time_s - timebase.start_time_s) * timebase.frame_rate_hz).astype(int) - track.start_frame
    rows = np.flatnonzero((frame >= 0) & (frame < len(seen.points_px)))
    observed_px, body_px = seen.points_px[frame[rows], bodies.camera[rows]], bodies.seen_px[rows]
    # The global pass may have swapped left and right.
    swapped = [joints.index(other_side(name)) for name in joints.names]
    apart_px = np.fmin(*(np.linalg.norm(some_px - observed_px, axis=-1) for some_px in (body_px, body_px[:, swapped])))
    is_both = np.isfinite(apart_px)
    rows, apart_px, body_px = (values[is_both.any(1)] for values in (rows, apart_px, body_px))
    middle_px = np.nanmedian(apart_px, axis=1) if len(rows) else np.empty(0)
    size_px = np.linalg.norm(np.nanmax(body_px, axis=1) - np.nanmin(body_px, axis=1), axis=-1)
    is_near = middle_px <= _MAX_APART * size_px
    rows, middle_px = rows[is_near], middle_px[is_near]
    ranked = rows[np.lexsort((middle_px, bodies.frame[rows], bodies.camera[rows]))]
    _, first = np.unique(np.stack([bodies.camera[ranked], bodies.frame[ranked]]), axis=1, return_index=True)
    return np.sort(ranked[first])


def _best_of_frames(*parts: Detections2D) -> Detections2D:
    """Points of each camera's frames with the highest score, whatever row they are in."""
    camera, frame, time_s = (np.concatenate([part[k] for part in parts]) for k in range(3))
    seen_px, score = (np.concatenate([part[k] for part in parts]) for k in (3, 4))
    pictures, first, picture = np.unique(np.stack([camera, frame]), axis=1, return_index=True, return_inverse=True)
    best_px = np.full((pictures.shape[1], *seen_px.shape[1:]), np.nan)
    best = np.zeros((pictures.shape[1], score.shape[1]))
    picture = picture.reshape(-1)
    for k in range(score.shape[1]):
        ranked = np.lexsort((score[:, k], picture))
        last = ranked[np.append(np.diff(picture[ranked]) != 0, True)[: len(ranked)]]
        best_px[picture[last], k], best[picture[last], k] = seen_px[last, k], score[last, k]
    colour = np.zeros((len(first), 0, 0), np.uint8)
    return Detections2D(pictures[0], pictures[1], time_s[first], best_px, best, colour)


def _stay_near(pairs: Iterable[tuple[Track3D, Track3D]], num: int) -> Bool[np.ndarray, " points"]:
    """Points that stay near the joints of people: tracks of points, and of the person in some of the same frames."""
    near, known = np.zeros(num, int), np.zeros(num, int)
    for given, person in pairs:
        points = _in_frames(given, person.frames)
        for k in range(num):
            apart_m = np.linalg.norm(points.xyz_m[:, k, None] - person.xyz_m, axis=-1)
            is_both = np.isfinite(apart_m)
            near[k] += (np.where(is_both, apart_m, np.inf).min(1, initial=np.inf) <= _NEAR_M).sum()
            known[k] += np.isfinite(points.xyz_m[:, k, 0]).sum()
    return (known > 0) & (near >= _NEAR_SHARE * known)


def _in_frames(points: Track3D, frames: range) -> Track3D:
    """Points in some of their frames."""
    return points.part(slice(frames.start - points.start_frame, frames.stop - points.start_frame))


def _columns(points: Track3D, columns: list[int]) -> Track3D:
    arrays: dict[str, Any] = {name: read_only(array[:, columns]) for name, array in points.joint_arrays.items()}
    return replace(points, **arrays)


def _with_column(points: Track3D, column: int, of_column: Track3D) -> Track3D:
    arrays: dict[str, Any] = {name: array.copy() for name, array in points.joint_arrays.items()}
    for name, array in of_column.joint_arrays.items():
        arrays[name][:, column] = array[:, 0]
        read_only(arrays[name])
    return replace(points, **arrays)
