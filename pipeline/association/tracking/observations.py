"""Detections of all cameras as arrays, and one person's observations at the output instants."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, UInt8

from pipeline.association.tracking.kernels.observation_kernels import Sampling, clear_unfound, sample
from pipeline.core.data.cameras import Camera, FrameTimes, Timebase
from pipeline.core.data.detections import Detections
from pipeline.core.data.people import Track3D
from pipeline.core.runtime import large_arrays
from pipeline.geometry.undistortion import undistort_px

UNASSIGNED = -1
"""Identity of a detection that belongs to no person."""


class Detections2D(NamedTuple):
    """Detections of all cameras, camera by camera and in order of frames."""

    # Position of the camera, its frame number and the frame's time, (detections,)
    camera: np.ndarray
    frame: np.ndarray
    time_s: np.ndarray
    # Joints in full-image pixels (distorted, as seen), (detections, joints, 2); NaN where a joint was not found
    seen_px: np.ndarray
    score: np.ndarray  # The detector's confidence, (detections, joints); 0 where a joint was not found
    # Histograms of the colours of the bodies' parts as bytes, (detections, parts, bins); zeros where a part is unknown.
    # Without parts and bins if colours were not measured.
    colour: np.ndarray


def gather(
    cameras: Sequence[Camera], times: Mapping[str, FrameTimes], detections: Mapping[str, Detections]
) -> Detections2D:
    """Copy the detections of all cameras into arrays. The cameras are in the order of ``Detections2D.camera``."""
    ordered = [detections[camera.name] for camera in cameras]
    seen_px = large_arrays.concatenate(
        [within_view(camera, of_camera.keypoints_px) for camera, of_camera in zip(cameras, ordered, strict=True)]
    )
    score = large_arrays.concatenate([of_camera.score for of_camera in ordered])
    clear_unfound(seen_px, score)
    return Detections2D(
        camera=np.repeat(np.arange(len(cameras)), [len(of_camera.frame) for of_camera in ordered]),
        frame=np.concatenate([of_camera.frame for of_camera in ordered]),
        time_s=np.concatenate([times[of_camera.camera].time_s[of_camera.frame] for of_camera in ordered]),
        seen_px=seen_px,
        score=score,
        colour=_gather_colours(ordered),
    )


def within_view(
    camera: Camera, seen_px: Float[np.ndarray, "detections joints 2"]
) -> Float[np.ndarray, "detections joints 2"]:
    """Joints of a camera; NaN beyond the angle to which a fisheye lens is used."""
    return seen_px if camera.lens == "standard" else np.where(np.isnan(undistort_px(camera, seen_px)), np.nan, seen_px)


def _gather_colours(ordered: Sequence[Detections]) -> UInt8[np.ndarray, "detections parts bins"]:
    """Colours of all cameras' detections: zeros for a camera without colours if another one has some."""
    measured = [of_camera.colour for of_camera in ordered if len(of_camera.colour)]
    if not measured:
        return np.zeros((sum(len(of_camera.frame) for of_camera in ordered), 0, 0), np.uint8)
    shape = measured[0].shape[1:]
    return large_arrays.concatenate(
        [
            of_camera.colour if len(of_camera.colour) else np.zeros((len(of_camera.frame), *shape), np.uint8)
            for of_camera in ordered
        ]
    )


def undistorted(cameras: Sequence[Camera], bodies: Detections2D) -> Float[np.ndarray, "detections joints 2"]:
    """Undistort the joints of all detections; returns ``bodies.seen_px`` itself if no camera has distortion."""
    if all(camera.is_ideal for camera in cameras):
        return bodies.seen_px
    ideal_px = large_arrays.empty(bodies.seen_px.shape)
    borders = np.searchsorted(bodies.camera, np.arange(len(cameras) + 1)).tolist()
    for camera, (first, last) in zip(cameras, pairwise(borders), strict=True):
        ideal_px[first:last] = undistort_px(camera, bodies.seen_px[first:last])
    return ideal_px


def rows_by_person(
    bodies: Detections2D, identity: Int[np.ndarray, " detections"]
) -> Iterator[Int[np.ndarray, " rows"]]:
    """Rows of each person's detections in ``bodies``, ascending.

    Of several detections of a person in one frame, the row with the highest sum of scores is kept. Rows with the
    identity ``UNASSIGNED`` are left out.
    """
    # NumPy sorts integers of 16 bits in linear time.
    is_small = identity.max(initial=UNASSIGNED) <= np.iinfo(np.int16).max
    by_person = np.argsort(identity.astype(np.int16) if is_small else identity, kind="stable")
    for rows in np.split(by_person, np.flatnonzero(np.diff(identity[by_person])) + 1):
        if len(rows) and identity[rows[0]] != UNASSIGNED:
            yield _best_in_frame(bodies, rows)


def _best_in_frame(bodies: Detections2D, rows: Int[np.ndarray, " rows"]) -> Int[np.ndarray, " _"]:
    camera, frame = bodies.camera[rows], bodies.frame[rows]
    if np.all((np.diff(camera) != 0) | (np.diff(frame) != 0)):
        return rows
    ranked = np.lexsort((-bodies.score[rows].sum(-1), frame, camera))
    is_first = np.append(True, (np.diff(camera[ranked]) != 0) | (np.diff(frame[ranked]) != 0))
    return rows[ranked[is_first]]


def make_sampling(
    timebase: Timebase, bodies: Detections2D, rows: Int[np.ndarray, " rows"], num_cameras: int, lambda_t_hz: float
) -> Sampling:
    """Prepare the sampling of a person's observations at the output instants.

    Instants go from half a period before the first observation to half a period after the last one. ``rows`` are those
    of the person's detections, ascending, at most one a camera and frame.
    """
    half_s = 0.5 / timebase.frame_rate_hz
    seen_s = bodies.time_s[rows]
    start = max(0, int(np.ceil((seen_s.min() - half_s - timebase.start_time_s) * timebase.frame_rate_hz)))
    stop = int(np.floor((seen_s.max() + half_s - timebase.start_time_s) * timebase.frame_rate_hz)) + 1
    instants_s = timebase.start_time_s + np.arange(start, min(stop, timebase.num_frames)) / timebase.frame_rate_hz
    first = np.searchsorted(bodies.camera[rows], np.arange(num_cameras + 1))
    return Sampling(start, rows, seen_s, bodies.frame[rows], first, first[:-1].copy(), instants_s, half_s, lambda_t_hz)


def observed_by(
    track: Track3D,
    bodies: Detections2D,
    rows: Int[np.ndarray, " rows"],
    num_cameras: int,
    timebase: Timebase,
    lambda_t_hz: float,
) -> tuple[Float[np.ndarray, "frames cameras joints 2"], Float[np.ndarray, "frames cameras joints"]]:
    """Sample a person's detections at the frames of a track, like tracking does; NaN and 0 without any.

    ``rows`` are the rows of the person's detections, ascending, at most one a camera and frame.
    """
    num_joints = bodies.score.shape[1]
    shape = track.num_frames, num_cameras, num_joints
    points_px, score = np.full((*shape, 2), np.nan), np.zeros(shape)
    if len(rows):
        times_s = timebase.start_time_s + (track.start_frame + np.arange(track.num_frames)) / timebase.frame_rate_hz
        sampling = make_sampling(timebase, bodies, rows, num_cameras, lambda_t_hz)
        sampling = sampling._replace(start_frame=track.start_frame, instants_s=times_s)
        flat_px = bodies.seen_px.reshape(len(bodies.seen_px), 2 * num_joints)
        sample(sampling, bodies, flat_px, points_px.reshape(*shape[:2], 2 * num_joints), score)
    return points_px, score


def sampled_in(life: slice, sampling: Sampling) -> Sampling:
    """Keep the instants of a slice of frames."""
    return sampling._replace(
        start_frame=sampling.start_frame + life.start, instants_s=sampling.instants_s[life.start : life.stop]
    )


def detections_at(timebase: Timebase, bodies: Detections2D, sampling: Sampling) -> Int[np.ndarray, "frames cameras"]:
    """Rows of a person's detections by nearest output frame and camera.

    Of several that are nearest to the same frame the last one counts; -1 where there is none.
    """
    rows = sampling.rows
    num_frames, num_cameras = len(sampling.instants_s), len(sampling.first) - 1
    nearest = np.rint((bodies.time_s[rows] - timebase.start_time_s) * timebase.frame_rate_hz).astype(np.int64)
    nearest -= sampling.start_frame
    is_inside = (nearest >= 0) & (nearest < num_frames)
    detection = np.full((num_frames, num_cameras), -1, np.int32)
    detection[nearest[is_inside], bodies.camera[rows[is_inside]]] = rows[is_inside]
    return detection
