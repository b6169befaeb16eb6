"""Resample motion to another frame rate."""

import math
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation, Slerp

from pipeline.core.data.animation import Animation, FootContact, SkeletonMotion
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Timebase
from pipeline.core.data.people import Source, Track3D
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.options.rules import SAME_INSTANT, num_resampled


def resample(reconstruction: Reconstruction, frame_rate_hz: float) -> Reconstruction:
    """Resample the final positions and skeletons of all people; the first output frame stays.

    Positions are interpolated linearly between two frames in which a joint is known, rotations along the shortest arc
    between two frames (slerp). Located joints and observations stay at the session's rate. People who appear only
    between two new frames are left out. ``frame_rate_hz`` is the rate of the new frames.
    """
    ratio = reconstruction.timebase.frame_rate_hz / frame_rate_hz  # old frames per new frame
    tracks, motions, own_tracks, own = [], [], [], reconstruction.own
    for number, (track, motion) in enumerate(zip(reconstruction.tracks, reconstruction.motions, strict=True)):
        frames = _new_frames(track.start_frame, track.num_frames, ratio)
        if len(frames):
            own_tracks += [_track_at(points, frames, ratio) for points in own.of_people[number : number + 1]]
            tracks.append(_track_at(track, frames, ratio))
            motions.append(_motion_at(motion, frames, ratio, frame_rate_hz))
    animation = Animation(tuple(tracks), tuple(motions), reconstruction.animation.floor)
    timebase = resampled_timebase(reconstruction.timebase, frame_rate_hz)
    objects = (thing._replace(track=_track_at(thing.track, range(timebase.num_frames), ratio)) for thing in own.objects)
    own = replace(own, of_people=tuple(own_tracks), objects=tuple(objects))
    return replace(reconstruction, timebase=timebase, animation=animation, own=own)


def on_clock(
    track: Track3D, motion: SkeletonMotion, old: Timebase, new: Timebase
) -> tuple[Track3D, SkeletonMotion] | None:
    """Final positions and skeleton of a person at the frames of another clock; ``None`` if there are none."""
    ratio = old.frame_rate_hz / new.frame_rate_hz
    shift = (new.start_time_s - old.start_time_s) * old.frame_rate_hz  # old frames before the first new frame
    inside = _new_frames(track.start_frame - shift, track.num_frames, ratio)
    frames = range(max(inside.start, 0), min(inside.stop, new.num_frames))
    if not frames:
        return None
    return _track_at(track, frames, ratio, shift), _motion_at(motion, frames, ratio, new.frame_rate_hz, shift)


def resampled_timebase(old: Timebase, frame_rate_hz: float) -> Timebase:
    """Timebase at another rate with the same first frame; its last frame is not after the old last frame."""
    num_frames = num_resampled(old.num_frames, old.frame_rate_hz, frame_rate_hz)
    return replace(old, frame_rate_hz=frame_rate_hz, num_frames=num_frames)


def _new_frames(start_frame: float, num_frames: int, ratio: float) -> range:
    """Numbers of the new frames within a range of old frames."""
    return range(
        math.ceil(start_frame / ratio - SAME_INSTANT),
        math.floor((start_frame + num_frames - 1) / ratio + SAME_INSTANT) + 1,
    )


def _between(
    frames: range, start_frame: float, num_frames: int, ratio: float
) -> tuple[Int[np.ndarray, " new"], Int[np.ndarray, " new"], Float[np.ndarray, " new"]]:
    """Old rows before and after each new frame, and the weight of the row after it, from 0 to 1."""
    place = np.arange(frames.start, frames.stop) * ratio - start_frame
    place = np.where(np.abs(place - np.round(place)) < SAME_INSTANT * num_frames, np.round(place), place)
    before = np.clip(np.floor(place).astype(np.int64), 0, num_frames - 1)
    weight = np.clip(place - before, 0.0, 1.0)
    return before, np.where(weight > 0, np.minimum(before + 1, num_frames - 1), before), weight


def _track_at(track: Track3D, frames: range, ratio: float, shift: float = 0.0) -> Track3D:
    before, behind, weight = _between(frames, track.start_frame - shift, track.num_frames, ratio)
    along = weight[:, None, None]
    xyz_m = np.where(along > 0, (1 - along) * track.xyz_m[before] + along * track.xyz_m[behind], track.xyz_m[before])
    nearest = np.where(weight < 0.5, before, behind)
    known = np.isfinite(xyz_m).all(-1)
    return Track3D(
        track_id=track.track_id,
        start_frame=frames.start,
        xyz_m=read_only(xyz_m),
        score=read_only(np.where(known, track.score[nearest], 0.0)),
        source=read_only(np.where(known, track.source[nearest], np.int8(Source.ABSENT))),
        error_px=read_only(np.where(known, track.error_px[nearest], np.nan)),
        views=read_only(np.where(known, track.views[nearest], 0)),
        uncertainty_m=None
        if track.uncertainty_m is None
        else read_only(np.where(known, track.uncertainty_m[nearest], np.nan)),
        world_from_segment=None if track.world_from_segment is None else track.world_from_segment[nearest],
    )


def _motion_at(
    motion: SkeletonMotion, frames: range, ratio: float, frame_rate_hz: float, shift: float = 0.0
) -> SkeletonMotion:
    before, behind, weight = _between(frames, motion.start_frame - shift, len(motion.root_m), ratio)
    along = weight[:, None]
    return replace(
        motion,
        start_frame=frames.start,
        frame_rate_hz=frame_rate_hz,
        root_m=read_only((1 - along) * motion.root_m[before] + along * motion.root_m[behind]),
        parent_from_joint=read_only(
            _rotations_at(motion.parent_from_joint, np.minimum(before + weight, len(motion.root_m) - 1))
        ),
        contacts=tuple(_contact_at(contact, motion.start_frame - shift, frames, ratio) for contact in motion.contacts),
    )


def _contact_at(contact: FootContact, start_frame: float, frames: range, ratio: float) -> FootContact:
    standing = _new_frames(start_frame + contact.start_frame, contact.num_frames, ratio)
    return replace(contact, start_frame=standing.start - frames.start, num_frames=len(standing))


def _rotations_at(
    quat_xyzw: Float[np.ndarray, "frames joints 4"], place: Float[np.ndarray, " new"]
) -> Float[np.ndarray, "new joints 4"]:
    """Interpolate the rotations (x, y, z, w) of all joints at fractional frame numbers."""
    if len(quat_xyzw) == 1:  # Slerp needs two rotations.
        return np.repeat(quat_xyzw, len(place), axis=0)
    frames = np.arange(len(quat_xyzw))
    joints = (Slerp(frames, Rotation.from_quat(joint))(place).as_quat() for joint in quat_xyzw.swapaxes(0, 1))
    return np.stack(list(joints), axis=1)
