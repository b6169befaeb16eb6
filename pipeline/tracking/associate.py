"""Cross-view tracking of a session: association of detections in time order, then triangulation of every person."""

from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np
from jaxtyping import Float, Int

from pipeline.data import Camera, Detections, FrameTimes, Leftovers, Observations, People, Timebase, Track3D
from pipeline.geometry.camera import image_from_world
from pipeline.geometry.track_assembly import number_people, record_life
from pipeline.geometry.tracks import triangulate_frames
from pipeline.progress import OnShare, ignore, part_of
from pipeline.tracking.observations import (
    Bodies,
    detections_at,
    gather,
    observations_at,
    rows_by_person,
    undistorted,
)
from pipeline.tracking.parameters import TrackingParameters
from pipeline.tracking.tracker import Tracker, make_frames


def associate(
    cameras: Sequence[Camera],
    times: Mapping[str, FrameTimes],
    detections: Mapping[str, Detections],
    parameters: TrackingParameters,
) -> dict[str, Int[np.ndarray, " _"]]:
    """Assign detections to people.

    Parameters
    ----------
    times, detections
        Frame times and detections by camera name.
    parameters
        See ``derive_parameters``.

    Returns
    -------
        Identity of each detection by camera name; ``NOBODY`` if it belongs to no target, or to a target that was never
        confirmed.
    """
    bodies = gather(cameras, times, detections)
    identity = _identify(cameras, times, bodies, undistorted(cameras, bodies), parameters, ignore, ignore)
    return {camera.name: identity[bodies.camera == number] for number, camera in enumerate(cameras)}


def locate_people(
    cameras: Sequence[Camera],
    times: Mapping[str, FrameTimes],
    detections: Mapping[str, Detections],
    identities: Mapping[str, Int[np.ndarray, " _"]],
    timebase: Timebase,
    parameters: TrackingParameters,
) -> People:
    """Triangulate every person at the output frames from all detections of the person's identity.

    Returns
    -------
        Tracks, numbered from 1 in order of their first frame, the observations behind each of them, and the bodies
        that are left.
    """
    bodies = gather(cameras, times, detections)
    person_rows = list(rows_by_person(bodies, np.concatenate([identities[camera.name] for camera in cameras])))
    xyz_m = _triangulate(cameras, bodies, undistorted(cameras, bodies), person_rows, timebase, parameters, ignore)
    return _record(cameras, bodies, person_rows, xyz_m, timebase, parameters, ignore)


def reconstruct_tracks(
    cameras: Sequence[Camera],
    times: Mapping[str, FrameTimes],
    detections: Mapping[str, Detections],
    timebase: Timebase,
    parameters: TrackingParameters,
) -> tuple[tuple[Track3D, ...], tuple[Observations, ...]]:
    """Associate detections, then locate every person; see ``associate`` and ``locate_people``."""
    people = track_bodies(cameras, times, gather(cameras, times, detections), timebase, parameters)
    return tuple(people.tracks), tuple(people.observations)


def track_bodies(
    cameras: Sequence[Camera],
    times: Mapping[str, FrameTimes],
    bodies: Bodies,
    timebase: Timebase,
    parameters: TrackingParameters,
    on_share: OnShare = ignore,
    on_approximate: Callable[[float], object] = ignore,
) -> People:
    """Associate gathered detections, then locate every person; the detections themselves may have been freed.

    Parameters
    ----------
    on_share
        Called with the completed share of the work; association counts as a half.
    on_approximate
        See ``Tracker.run``.
    """
    # Distorted and undistorted joints are sampled one after the other: both at once, for all people, would take half as
    # much memory again as the result.
    ideal_px = undistorted(cameras, bodies)
    identity = _identify(cameras, times, bodies, ideal_px, parameters, part_of(on_share, 0.0, 0.5), on_approximate)
    person_rows = list(rows_by_person(bodies, identity))
    xyz_m = _triangulate(cameras, bodies, ideal_px, person_rows, timebase, parameters, part_of(on_share, 0.5, 0.75))
    del ideal_px
    return _record(cameras, bodies, person_rows, xyz_m, timebase, parameters, part_of(on_share, 0.75, 1.0))


def _identify(
    cameras: Sequence[Camera],
    times: Mapping[str, FrameTimes],
    bodies: Bodies,
    ideal_px: Float[np.ndarray, "detections joints 2"],
    parameters: TrackingParameters,
    on_share: OnShare,
    on_approximate: Callable[[float], object],
) -> Int[np.ndarray, " detections"]:
    """Run the tracker; see ``associate``."""
    frames = make_frames([times[camera.name] for camera in cameras], bodies, ideal_px, parameters.min_score)
    return Tracker(cameras, frames, parameters).run(on_share, on_approximate)


def _triangulate(
    cameras: Sequence[Camera],
    bodies: Bodies,
    ideal_px: Float[np.ndarray, "detections joints 2"],
    person_rows: Sequence[Int[np.ndarray, " _"]],
    timebase: Timebase,
    parameters: TrackingParameters,
    on_share: OnShare,
) -> list[Float[np.ndarray, "_ joints 3"]]:
    """Triangulate each person at the output instants, robustly; ``person_rows`` holds the rows of each person."""
    projections = np.array([image_from_world(camera) for camera in cameras])

    def located_m(rows: Int[np.ndarray, " _"]) -> Float[np.ndarray, "frames joints 3"]:
        sampled = observations_at(timebase, bodies, ideal_px, rows, len(cameras), parameters)
        return triangulate_frames(projections, sampled.points_px, sampled.score, parameters.min_score)

    return [located_m(rows) for rows in _reported(person_rows, on_share)]


def _record(
    cameras: Sequence[Camera],
    bodies: Bodies,
    person_rows: Sequence[Int[np.ndarray, " _"]],
    xyz_m: Sequence[Float[np.ndarray, "_ joints 3"]],
    timebase: Timebase,
    parameters: TrackingParameters,
    on_share: OnShare,
) -> People:
    """Make each person's track, and the observations behind it in distorted pixels."""
    recorded, is_left = [], np.ones(len(bodies.camera), bool)
    for rows, person_m in zip(_reported(person_rows, on_share), xyz_m, strict=True):
        seen = observations_at(timebase, bodies, bodies.seen_px, rows, len(cameras), parameters)
        detection = detections_at(timebase, bodies, rows, seen) if bodies.colour.size else None
        person = record_life(
            cameras, timebase, seen.start_frame, person_m, seen.points_px, seen.score, parameters.min_score, detection
        )
        if person is not None:
            recorded.append(person)
            is_left[rows] = False
    return People(*number_people(recorded), leftovers=_leftovers(bodies, np.flatnonzero(is_left), timebase))


def _leftovers(bodies: Bodies, rows: Int[np.ndarray, " n"], timebase: Timebase) -> Leftovers:
    place = (bodies.time_s[rows] - timebase.start_time_s) * timebase.frame_rate_hz
    frame = np.round(place).astype(int)
    inside = (frame >= 0) & (frame < timebase.num_frames)
    rows, frame = rows[inside], frame[inside]
    return Leftovers(frame, bodies.camera[rows], bodies.seen_px[rows], bodies.score[rows])


def _reported(person_rows: Sequence[Int[np.ndarray, " _"]], on_share: OnShare) -> Iterator[Int[np.ndarray, " rows"]]:
    """Yield each person's rows, and report the share of all rows after each person."""
    num_all, num_done = sum(map(len, person_rows)), 0
    for rows in person_rows:
        yield rows
        num_done += len(rows)
        on_share(num_done / num_all)
