"""What all cameras saw, in arrays; and what they saw of one person, brought to the output instants."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from pipeline.data import Camera, Detections, FrameTimes, Timebase
from pipeline.geometry.undistortion import undistort_px
from pipeline.tracking.kernels.observation_kernels import clear_unfound, sample_observations
from pipeline.tracking.parameters import TrackingParameters

NOBODY = -1
"""The identity of a detection that belongs to nobody."""


class Bodies(NamedTuple):
    """All detections, camera by camera, each camera's in order of frames.

    Parameters
    ----------
    camera, frame, time_s
        Position of the camera, its frame number and time; one a detection.
    seen_px
        Joints as seen, (detections, joints, 2).
    score
        The detector's, (detections, joints), 0 for joints that it did not find.
    """

    camera: np.ndarray
    frame: np.ndarray
    time_s: np.ndarray
    seen_px: np.ndarray
    score: np.ndarray


def gather(cameras: Sequence[Camera], times: Mapping[str, FrameTimes], detections: Mapping[str, Detections]) -> Bodies:
    """Copy all cameras' detections into arrays."""
    ordered = [detections[camera.name] for camera in cameras]
    seen_px = np.concatenate([one.keypoints_px for one in ordered])
    score = np.concatenate([one.score for one in ordered])
    clear_unfound(seen_px, score)
    return Bodies(
        camera=np.repeat(np.arange(len(cameras)), [len(one.frame) for one in ordered]),
        frame=np.concatenate([one.frame for one in ordered]),
        time_s=np.concatenate([times[one.camera].time_s[one.frame] for one in ordered]),
        seen_px=seen_px,
        score=score,
    )


def undistorted(cameras: Sequence[Camera], bodies: Bodies) -> Float[np.ndarray, "detections joints 2"]:
    """Joints in undistorted pixels; ``bodies.seen_px`` itself if no camera distorts."""
    if not any(np.any(camera.distortion) for camera in cameras):
        return bodies.seen_px
    ideal_px = np.empty_like(bodies.seen_px)  # filled camera by camera: a long session is a large part of the memory
    borders = np.searchsorted(bodies.camera, np.arange(len(cameras) + 1)).tolist()
    for camera, (first, last) in zip(cameras, pairwise(borders), strict=True):
        ideal_px[first:last] = undistort_px(camera, bodies.seen_px[first:last])
    return ideal_px


def rows_by_person(bodies: Bodies, identity: Int[np.ndarray, " detections"]) -> Iterator[Int[np.ndarray, " rows"]]:
    """Rows of each person's detections, ascending; of two in a frame the one with the higher scores."""
    by_person = np.argsort(identity, kind="stable")
    for rows in np.split(by_person, np.flatnonzero(np.diff(identity[by_person])) + 1):
        if len(rows) and identity[rows[0]] != NOBODY:
            yield _one_a_frame(bodies, rows)


def _one_a_frame(bodies: Bodies, rows: Int[np.ndarray, " rows"]) -> Int[np.ndarray, " _"]:
    camera, frame = bodies.camera[rows], bodies.frame[rows]
    if np.all((np.diff(camera) != 0) | (np.diff(frame) != 0)):
        return rows
    ranked = np.lexsort((-bodies.score[rows].sum(-1), frame, camera))
    is_first = np.append(True, (np.diff(camera[ranked]) != 0) | (np.diff(frame[ranked]) != 0))
    return rows[ranked[is_first]]


class Sampled(NamedTuple):
    """One person's observations at the output instants of a life.

    Parameters
    ----------
    start_frame
        Output frame of the first row.
    points_px
        (frames, cameras, joints, 2), NaN where a camera has no observation.
    score
        (frames, cameras, joints), 0 where there is none.
    """

    start_frame: int
    points_px: np.ndarray
    score: np.ndarray


def observations_at(
    timebase: Timebase,
    bodies: Bodies,
    points_px: Float[np.ndarray, "detections joints 2"],
    rows: Int[np.ndarray, " rows"],
    num_cameras: int,
    parameters: TrackingParameters,
) -> Sampled:
    """Observations of every camera at the output instants of a person's life.

    An output instant between two consecutive frames of a camera takes their linear interpolation, so that cameras that
    are not synchronised agree on the instant; its score falls with the distance to the nearer frame as old observations
    do, ``exp(-lambda_t |t - t_i|)`` (Chen et al. 2020, eq. 11). Where a neighbour is missing, a frame within half a
    period stands for the instant. Nothing is made up across missed frames.

    Parameters
    ----------
    points_px
        Joints of ``bodies``, as seen or undistorted.
    rows
        The person's detections.
    """
    half_s = 0.5 / timebase.frame_rate_hz
    instants_s = _instants_s(timebase, bodies.time_s[rows], half_s)
    shape = (len(instants_s), num_cameras, bodies.score.shape[1])
    sampled_px, score = np.empty((*shape, 2)), np.empty(shape)
    sample_observations(rows, bodies, points_px, instants_s, half_s, parameters.lambda_t_hz, sampled_px, score)
    start_frame = (
        round(float((instants_s[0] - timebase.start_time_s) * timebase.frame_rate_hz)) if len(instants_s) else 0
    )
    return Sampled(start_frame, sampled_px, score)


def _instants_s(timebase: Timebase, seen_s: Float[np.ndarray, " rows"], half_s: float) -> Float[np.ndarray, " frames"]:
    """Output instants from half a period before the first observation to half a period after the last."""
    start = max(0, int(np.ceil((seen_s.min() - half_s - timebase.start_time_s) * timebase.frame_rate_hz)))
    stop = int(np.floor((seen_s.max() + half_s - timebase.start_time_s) * timebase.frame_rate_hz)) + 1
    return timebase.start_time_s + np.arange(start, min(stop, timebase.num_frames)) / timebase.frame_rate_hz
