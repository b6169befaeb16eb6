"""People who vanish in the middle of the room: they are not found any more where cameras view the place.

A person who leaves goes through the border of the pictures, or through a door: beyond all cameras and all places where
people are in the take. Any other person who is whole in the pictures of half of the cameras, now and half a second
later, has not left: the person is hidden, or was not detected or not matched.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float

from pipeline.association.identity.merging import runs
from pipeline.association.identity.recover_detections import MIN_JOINTS
from pipeline.core.data.arrays import mean_known
from pipeline.core.data.cameras import Camera, FrameTimes, Timebase
from pipeline.core.data.people import PersonLoss, Track3D
from pipeline.core.runtime import large_arrays
from pipeline.geometry.camera import center_in_world, project

# Shortest time without a person before the end of the take, and between two moments of the person: shorter gaps are
# filled by the fit.
_SHORTEST_S, _SHORTEST_GAP_S = 0.5, 1.0
# Time before the loss that tells pose and velocity, and time after it for which the person continues so.
_RECENT_S, _GOES_ON_S = 0.2, 0.5
# Distance from all cameras and people at which a person has left, who continues for a second as in the second before;
# and directions that are looked into.
_LEFT_M, _LEAVES_S = 0.25, 1.0
_DIRECTIONS = np.stack([np.cos(angles := np.linspace(0.0, 2 * np.pi, 72, endpoint=False)), np.sin(angles)], axis=-1)
# Distance at which another person, there or soon after, is the same one under another number.
_SAME_M = 0.5
# Longest time to the nearest frame of a camera that records, in seconds and output frames.
_RECORDS_S, _RECORDS_FRAMES = 0.25, 0.75
# Rate below which a person may walk off from one frame to the next.
_FOLLOWED_HZ = 9.3


def find_losses(
    tracks: Sequence[Track3D], cameras: Sequence[Camera], times: Mapping[str, FrameTimes], timebase: Timebase
) -> list[PersonLoss]:
    """Find the frames in which people are lost in the middle of the cameras' common view.

    ``tracks`` are as association located them, ``times`` the times of each camera's frames by its name.
    """
    rate_hz = timebase.frame_rate_hz
    if rate_hz < _FOLLOWED_HZ:
        return []
    records = np.stack([_records(times[camera.name], timebase) for camera in cameras], axis=-1)
    middles = [_middle_m(track, timebase) for track in tracks]
    centers_m = [center_in_world(camera)[None] for camera in cameras]
    places_m = np.concatenate([*centers_m, *(middle_m[np.isfinite(middle_m[:, 0])] for middle_m in middles)])
    border_m = (places_m[:, :2] @ _DIRECTIONS.T).max(0) + _LEFT_M
    losses = []
    for track, middle_m in zip(tracks, middles, strict=True):
        for gap in runs(np.isnan(middle_m[:, 0])):
            is_end = gap.stop == timebase.num_frames
            shortest = (_SHORTEST_S if is_end else _SHORTEST_GAP_S) * rate_hz
            if gap.start == 0 or records[gap].any(-1).sum() < shortest:
                continue
            place_m = middle_m[gap.start - 1]
            soon = slice(gap.start, min(gap.stop, gap.start + round(_GOES_ON_S * rate_hz)))
            is_another = any(
                (np.linalg.norm(other_m[soon] - place_m, axis=-1) <= _SAME_M).any()
                for other_m in middles
                if other_m is not middle_m
            )
            joints_m, goes_m = _last_joints_m(track, middle_m, gap.start, rate_hz)
            before_m = middle_m[max(track.start_frame, gap.start - 1 - round(_LEAVES_S * rate_hz))]
            has_left = ((2 * place_m - before_m)[:2] @ _DIRECTIONS.T > border_m).any()
            sees_whole = _sees_whole(np.concatenate([joints_m, joints_m + goes_m]), cameras)
            num_views = np.count_nonzero(sees_whole & records[soon].any(0))
            if num_views >= max(2, len(cameras) / 2) and not (is_another or has_left):
                place = tuple(place_m.round(3).tolist())
                losses.append(PersonLoss("vanished", track.track_id, gap.start, gap.stop, place))
    return losses


def _records(times: FrameTimes, timebase: Timebase) -> Bool[np.ndarray, " frames"]:
    """Output frames near which a camera took a frame."""
    output_s = timebase.start_time_s + np.arange(timebase.num_frames) / timebase.frame_rate_hz
    after = np.searchsorted(times.time_s, output_s)
    around = np.clip([after - 1, after], 0, len(times.time_s) - 1)
    nearest_s = np.abs(times.time_s[around] - output_s).min(0)
    return np.asarray(nearest_s <= max(_RECORDS_S, _RECORDS_FRAMES / timebase.frame_rate_hz))


def _middle_m(track: Track3D, timebase: Timebase) -> Float[np.ndarray, "frames 3"]:
    """Middle of a person's joints in all output frames; NaN where the person is not located."""
    middle_m = np.full((timebase.num_frames, 3), np.nan)
    for rows in large_arrays.blocks(track.num_frames):
        xyz_m = track.xyz_m[rows]
        is_located = np.isfinite(xyz_m).sum(1) >= MIN_JOINTS
        middle_m[track.start_frame :][rows] = np.where(is_located, mean_known(xyz_m, 1), np.nan)
    return middle_m


def _last_joints_m(
    track: Track3D, middle_m: Float[np.ndarray, "frames 3"], stop: int, rate_hz: float
) -> tuple[Float[np.ndarray, "joints 3"], Float[np.ndarray, " 3"]]:
    """Joints shortly before a frame, and the way on which the person would go soon after it."""
    start = max(track.start_frame, stop - max(2, round(_RECENT_S * rate_hz)))
    joints_m = track.xyz_m[start - track.start_frame : stop - track.start_frame].reshape(-1, 3)
    steps_m = np.diff(middle_m[start:stop], axis=0)
    steps_m = steps_m[np.isfinite(steps_m).all(-1)]
    goes_m = np.median(steps_m, axis=0) * _GOES_ON_S * rate_hz if len(steps_m) else np.zeros(3)
    return joints_m[np.isfinite(joints_m).all(-1)], goes_m


def _sees_whole(joints_m: Float[np.ndarray, "joints 3"], cameras: Sequence[Camera]) -> Bool[np.ndarray, " cameras"]:
    inside = []
    for camera in cameras:
        joints_px = project(camera, joints_m)
        inside.append(((joints_px >= 0) & (joints_px < np.array(camera.size_px))).all())
    return np.array(inside)
