"""From detections to tracks: association in time order, then every joint from all that was matched to it."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from jaxtyping import Int

from pipeline.data import Camera, Detections, FrameTimes, Observations, Timebase, Track3D
from pipeline.geometry.life import number_people
from pipeline.progress import OnShare, ignore, part_of
from pipeline.tracking.observations import NOBODY, Bodies, gather, observations_at, people
from pipeline.tracking.parameters import TrackingParameters
from pipeline.tracking.positions import locate
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
    bodies = gather(cameras, times, detections, parameters.min_score)
    frames = make_frames([times[camera.name] for camera in cameras], bodies)
    identity = Tracker(cameras, frames, parameters).run()
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
    bodies = gather(cameras, times, detections, parameters.min_score)
    identity = np.concatenate([identities[camera.name] for camera in cameras])
    return _locate(cameras, bodies, identity, timebase, parameters, ignore)


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
    on_share
        Called with the share of the work that is done; each of the two steps counts as a half.
    on_approximate
        See ``Tracker.run``.
    """
    bodies = gather(cameras, times, detections, parameters.min_score)
    tracker = Tracker(cameras, make_frames([times[camera.name] for camera in cameras], bodies), parameters)
    identity = tracker.run(part_of(on_share, 0.0, 0.5), on_approximate)
    # Frees the array that the tracker alone needs: a long session is a large part of the memory.
    del tracker
    bodies = bodies._replace(used=bodies.score)
    return _locate(cameras, bodies, identity, timebase, parameters, part_of(on_share, 0.5, 1.0))


def _locate(
    cameras: Sequence[Camera],
    bodies: Bodies,
    identity: Int[np.ndarray, " detections"],
    timebase: Timebase,
    parameters: TrackingParameters,
    on_share: OnShare,
) -> People:
    found, num_done = [], 0
    num_identified = int((identity != NOBODY).sum())
    for rows in people(bodies, identity):
        sampled = observations_at(timebase, bodies, rows, len(cameras), parameters)
        located = locate(cameras, sampled, timebase, parameters.min_score)
        if located is not None:
            found.append(located)
        num_done += len(rows)
        on_share(num_done / num_identified)
    return number_people(found)
