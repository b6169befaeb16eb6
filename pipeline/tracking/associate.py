"""From detections to tracks: association in time order, then every joint from all that was matched to it."""

from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np
from jaxtyping import Float, Int

from pipeline.data import Camera, Detections, FrameTimes, Observations, Timebase, Track3D
from pipeline.geometry.camera import image_from_world
from pipeline.geometry.track_assembly import number_people, record_life
from pipeline.geometry.tracks import triangulate_frames
from pipeline.progress import OnShare, ignore, part_of
from pipeline.tracking.observations import Bodies, gather, observations_at, rows_by_person, undistorted
from pipeline.tracking.parameters import TrackingParameters
from pipeline.tracking.tracker import Tracker, make_frames

People = tuple[tuple[Track3D, ...], tuple[Observations, ...]]


def associate(
    cameras: Sequence[Camera],
    times: Mapping[str, FrameTimes],
    detections: Mapping[str, Detections],
    parameters: TrackingParameters,
) -> dict[str, Int[np.ndarray, " _"]]:
    """Give every detection the identity of a person.

    Parameters
    ----------
    cameras
        Those of ``times`` and ``detections``, in any order.
    times
        When each camera took its frames.
    detections
        What each camera's frames show.
    parameters
        See ``derive_parameters``.

    Returns
    -------
        For every camera an identity a detection, ``NOBODY`` where it belongs to none or to one that did not earn its
        birth.
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
    """Locate every person's joints at the output frames from all detections of one identity.

    Returns
    -------
        Tracks numbered from 1 in order of their first frame, and the observations behind each.
    """
    bodies = gather(cameras, times, detections)
    lives = list(rows_by_person(bodies, np.concatenate([identities[camera.name] for camera in cameras])))
    xyz_m = _triangulate(cameras, bodies, undistorted(cameras, bodies), lives, timebase, parameters, ignore)
    return _record(cameras, bodies, lives, xyz_m, timebase, parameters, ignore)


def reconstruct_tracks(
    cameras: Sequence[Camera],
    times: Mapping[str, FrameTimes],
    detections: Mapping[str, Detections],
    timebase: Timebase,
    parameters: TrackingParameters,
    on_share: OnShare = ignore,
    on_approximate: Callable[[float], object] = ignore,
) -> People:
    """Associate detections, then locate every person; see ``associate`` and ``locate_people``.

    Parameters
    ----------
    on_share, on_approximate
        See ``track_bodies``.
    """
    bodies = gather(cameras, times, detections)
    return track_bodies(cameras, times, bodies, timebase, parameters, on_share, on_approximate)


def track_bodies(
    cameras: Sequence[Camera],
    times: Mapping[str, FrameTimes],
    bodies: Bodies,
    timebase: Timebase,
    parameters: TrackingParameters,
    on_share: OnShare = ignore,
    on_approximate: Callable[[float], object] = ignore,
) -> People:
    """``reconstruct_tracks`` of detections that were gathered, and need not be in memory any more.

    Parameters
    ----------
    on_share
        Called with the share of the work that is done; association counts as a half.
    on_approximate
        See ``Tracker.run``.
    """
    # Joints as seen and undistorted are not sampled together: in memory at once, and all people's of each, they would
    # take half as much again as the result.
    ideal_px = undistorted(cameras, bodies)
    identity = _identify(cameras, times, bodies, ideal_px, parameters, part_of(on_share, 0.0, 0.5), on_approximate)
    lives = list(rows_by_person(bodies, identity))
    xyz_m = _triangulate(cameras, bodies, ideal_px, lives, timebase, parameters, part_of(on_share, 0.5, 0.75))
    del ideal_px
    return _record(cameras, bodies, lives, xyz_m, timebase, parameters, part_of(on_share, 0.75, 1.0))


def _identify(
    cameras: Sequence[Camera],
    times: Mapping[str, FrameTimes],
    bodies: Bodies,
    ideal_px: Float[np.ndarray, "detections joints 2"],
    parameters: TrackingParameters,
    on_share: OnShare,
    on_approximate: Callable[[float], object],
) -> Int[np.ndarray, " detections"]:
    """The identity of each detection."""
    frames = make_frames([times[camera.name] for camera in cameras], bodies, ideal_px, parameters.min_score)
    return Tracker(cameras, frames, parameters).run(on_share, on_approximate)


def _triangulate(
    cameras: Sequence[Camera],
    bodies: Bodies,
    ideal_px: Float[np.ndarray, "detections joints 2"],
    lives: Sequence[Int[np.ndarray, " _"]],
    timebase: Timebase,
    parameters: TrackingParameters,
    on_share: OnShare,
) -> list[Float[np.ndarray, "_ joints 3"]]:
    """Everybody's joints in space at the output instants of their lives, robustly."""
    projections = np.array([image_from_world(camera) for camera in cameras])

    def located_m(rows: Int[np.ndarray, " _"]) -> Float[np.ndarray, "frames joints 3"]:
        sampled = observations_at(timebase, bodies, ideal_px, rows, len(cameras), parameters)
        return triangulate_frames(projections, sampled.points_px, sampled.score, parameters.min_score)

    return [located_m(rows) for rows in _reported(lives, on_share)]


def _record(
    cameras: Sequence[Camera],
    bodies: Bodies,
    lives: Sequence[Int[np.ndarray, " _"]],
    xyz_m: Sequence[Float[np.ndarray, "_ joints 3"]],
    timebase: Timebase,
    parameters: TrackingParameters,
    on_share: OnShare,
) -> People:
    """Everybody's track, and the observations behind it as they were seen."""
    found = []
    for rows, mine_m in zip(_reported(lives, on_share), xyz_m, strict=True):
        seen = observations_at(timebase, bodies, bodies.seen_px, rows, len(cameras), parameters)
        person = record_life(
            cameras, timebase, seen.start_frame, mine_m, seen.points_px, seen.score, parameters.min_score
        )
        if person is not None:
            found.append(person)
    return number_people(found)


def _reported(lives: Sequence[Int[np.ndarray, " _"]], on_share: OnShare) -> Iterator[Int[np.ndarray, " rows"]]:
    """Lives, each of which counts by its detections when the next one is asked for."""
    num_all, num_done = sum(map(len, lives)), 0
    for rows in lives:
        yield rows
        num_done += len(rows)
        on_share(num_done / num_all)
