"""From detections to tracks: association in time order, then every joint from all that was matched to it."""

import heapq
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from jaxtyping import Float

from pipeline.data import Camera, Detections, FrameTimes, Observations, Timebase, Track3D
from pipeline.geometry.camera import undistort_px
from pipeline.tracking.observations import Matched, observations_at
from pipeline.tracking.parameters import TrackingParameters
from pipeline.tracking.positions import locate
from pipeline.tracking.tracker import NOBODY, Tracker

# Detections undistorted at a time: many for speed, few for memory.
_BLOCK = 1000


def _frames_in_time_order(times: Sequence[FrameTimes]) -> Iterator[tuple[float, int, int]]:
    """(time, camera, frame) of all cameras in time order; cameras at the same instant in their order."""

    def of_camera(camera: int, one: FrameTimes) -> Iterator[tuple[float, int, int]]:
        return ((float(time_s), camera, frame) for frame, time_s in enumerate(one.time_s))

    return heapq.merge(*(of_camera(camera, one) for camera, one in enumerate(times)))


def associate(
    cameras: Sequence[Camera],
    times: Mapping[str, FrameTimes],
    detections: Mapping[str, Detections],
    parameters: TrackingParameters,
) -> dict[str, np.ndarray]:
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
    ordered = [detections[camera.name] for camera in cameras]
    identities = [np.full(len(one.frame), NOBODY) for one in ordered]
    points_px, scores = zip(
        *(_usable(camera, one, parameters.min_score) for camera, one in zip(cameras, ordered, strict=True)), strict=True
    )
    current = [slice(0, 0)] * len(cameras)
    tracker = Tracker(cameras, ordered[0].keypoints_px.shape[1], parameters)
    for time_s, camera, frame in _frames_in_time_order([times[camera.name] for camera in cameras]):
        one = ordered[camera]
        rows = slice(*np.searchsorted(one.frame, [frame, frame + 1]))
        current[camera] = rows
        identities[camera][rows], late = tracker.step(camera, time_s, points_px[camera][rows], scores[camera][rows])
        for other, row, identity in late:
            identities[other][current[other].start + row] = identity

    final = np.array([tracker.identity(k) for k in range(tracker.num_born)] + [NOBODY])
    final[~np.isin(final, list(tracker.confirmed))] = NOBODY
    return {camera.name: final[found] for camera, found in zip(cameras, identities, strict=True)}


def _usable(
    camera: Camera, detections: Detections, min_score: float
) -> tuple[Float[np.ndarray, "n joints 2"], Float[np.ndarray, "n joints"]]:
    """Undistorted joints and their scores, NaN and 0 where the detector is unsure; many frames in one go."""
    usable = (detections.score >= min_score) & np.isfinite(detections.keypoints_px).all(-1)
    points_px = np.where(usable[..., None], detections.keypoints_px, np.nan)
    for start in range(0, len(points_px), _BLOCK):
        points_px[start : start + _BLOCK] = undistort_px(camera, points_px[start : start + _BLOCK])
    return points_px, np.where(usable, detections.score, 0.0)


def reconstruct_tracks(
    cameras: Sequence[Camera],
    times: Mapping[str, FrameTimes],
    detections: Mapping[str, Detections],
    timebase: Timebase,
    parameters: TrackingParameters,
) -> tuple[tuple[Track3D, ...], tuple[Observations, ...]]:
    """Associate detections, then locate every person; see ``associate`` and ``locate_people``."""
    identities = associate(cameras, times, detections, parameters)
    return locate_people(cameras, times, detections, identities, timebase, parameters)


def locate_people(
    cameras: Sequence[Camera],
    times: Mapping[str, FrameTimes],
    detections: Mapping[str, Detections],
    identities: Mapping[str, np.ndarray],
    timebase: Timebase,
    parameters: TrackingParameters,
) -> tuple[tuple[Track3D, ...], tuple[Observations, ...]]:
    """Locate every person's joints at the output frames from all detections of one identity.

    Returns
    -------
        Tracks numbered from 1 in order of their first frame, and the observations behind each.
    """
    found = []
    for identity in np.unique(np.concatenate([*identities.values(), [NOBODY]])):
        if identity == NOBODY:
            continue
        matched = [
            Matched.of(detections[camera.name], times[camera.name], identities[camera.name] == identity)
            for camera in cameras
        ]
        start_frame, points_px, score = observations_at(timebase, matched, parameters)
        located = locate(cameras, start_frame, points_px, score, timebase, parameters)
        if located is not None:
            found.append(located)
    found.sort(key=lambda pair: pair[0].start_frame)
    return (
        tuple(_numbered(track, k) for k, (track, _) in enumerate(found, start=1)),
        tuple(Observations(k, one.points_px, one.score) for k, (_, one) in enumerate(found, start=1)),
    )


def _numbered(track: Track3D, track_id: int) -> Track3D:
    return Track3D(track_id, track.start_frame, track.xyz_m, track.score, track.source, track.error_px, track.views)
