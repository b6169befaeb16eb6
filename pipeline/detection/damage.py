"""Damaged and doubled pictures of a session's videos: found, summarised for users, and limited."""

from collections.abc import Iterable, Sequence

import numpy as np
from jaxtyping import Float, Int, UInt8

from pipeline.capture.session import CaptureSession
from pipeline.core.data.arrays import read_only
from pipeline.core.data.detections import DamagedVideo, PictureChanges
from pipeline.core.errors import InputError, Problem
from pipeline.core.problems.session_codes import VIDEO_DAMAGED
from pipeline.video.timeline import frames_in, session_timebase, span_s

_SAMPLES_A_SIDE = 64
# Share of the samples whose changes count, the largest ones: people are a small part of the picture, and the noise of
# coding is everywhere.
_LARGEST = 0.02
# Doubled pictures of the sample capture and of rendered people, coded by four encoders, changed by 0.09 to 0.31 of what
# the pictures around them changed by; other pictures by 0.35 or more.
_MAX_SHARE = 0.28
# Usual change around a picture, in grey levels, below which the scene stands still.
_MIN_CHANGE = 2.0
# Frames on each side. Of 24 pictures that are shown 60 times a second three of five are doubled.
_AROUND = 6
_MIN_KNOWN = 3


class ChangeMeter:
    """Measures the change of each picture of a range of frames from the picture before."""

    def __init__(self) -> None:
        self._frames: list[int] = []
        self._changes: list[float] = []
        self._first = self._last = np.zeros(0, np.uint8)

    def add(self, frame: int, image_rgb: UInt8[np.ndarray, "height width 3"]) -> None:
        """Measure the next picture; frames ascend."""
        steps = [max(1, side // _SAMPLES_A_SIDE) for side in image_rgb.shape[:2]]
        samples = image_rgb[:: steps[0], :: steps[1], 1].ravel()
        is_next = bool(self._frames) and frame == self._frames[-1] + 1
        self._changes.append(_change(self._last, samples) if is_next else np.nan)
        self._frames.append(frame)
        if not len(self._first):
            self._first = samples.copy()
        self._last = samples.copy()

    def changes(self) -> PictureChanges:
        """Changes of all pictures so far."""
        return PictureChanges(
            read_only(np.array(self._frames, np.int64)),
            read_only(np.array(self._changes, np.float32)),
            read_only(self._first),
            read_only(self._last),
        )


def join_changes(parts: Sequence[PictureChanges]) -> PictureChanges:
    """Join the changes of ranges of a camera, in order of time: the same as for one range."""
    parts = [part for part in parts if len(part.frame)]
    if not parts:
        return PictureChanges()
    change = np.concatenate([part.change for part in parts])
    starts = np.cumsum([len(part.frame) for part in parts])[:-1]
    for start, before, after in zip(starts, parts[:-1], parts[1:], strict=True):
        if after.frame[0] == before.frame[-1] + 1 and np.isnan(change[start]):
            change[start] = _change(before.last, after.first)
    frame = np.concatenate([part.frame for part in parts])
    return PictureChanges(read_only(frame), read_only(change), parts[0].first, parts[-1].last)


def doubled_frames(changes: PictureChanges) -> Int[np.ndarray, " doubled"]:
    """Numbers of the frames that show the picture before once more."""
    return changes.frame[changes.change < _MAX_SHARE * _usual_change(changes.change)]


def _usual_change(change: Float[np.ndarray, " frames"]) -> Float[np.ndarray, " frames"]:
    """Upper quartile of the changes before and after each picture, the smaller one; 0 where the scene stands still."""
    padded = np.pad(change.astype(np.float64), _AROUND, constant_values=np.nan)
    # Unknown changes are sorted to the end of their window.
    windows = np.sort(np.lib.stride_tricks.sliding_window_view(padded, _AROUND), axis=1)
    num_known = np.count_nonzero(~np.isnan(windows), axis=1)
    places = np.ceil(0.75 * np.maximum(num_known - 1, 0)).astype(np.int64)
    # A side with too few pictures says nothing.
    quartiles = np.where(num_known >= _MIN_KNOWN, windows[np.arange(len(windows)), places], np.inf)
    # Window k is before frame k, and window k + _AROUND + 1 after it.
    usual = np.minimum(quartiles[: len(change)], quartiles[_AROUND + 1 :])
    return np.where(np.isfinite(usual) & (usual >= _MIN_CHANGE), usual, 0.0)


def _change(before: UInt8[np.ndarray, " samples"], after: UInt8[np.ndarray, " samples"]) -> float:
    """Mean of the largest differences between samples of two pictures; NaN if their sizes differ."""
    if len(before) != len(after):
        return np.nan
    differences = np.abs(after.astype(np.int16) - before)
    count = max(1, round(_LARGEST * len(differences)))
    return float(np.partition(differences, -count)[-count:].mean())


MAX_DAMAGED_SHARE = 0.1
"""Limit on the damaged share of a camera's frames, among the frames that a reconstruction uses."""


CheckedPictures = tuple[str, Int[np.ndarray, " _"], PictureChanges]
"""Name of a camera, ascending numbers of its frames with a damaged or missing picture, and changes of its pictures."""


def damaged_videos(session: CaptureSession, pictures: Iterable[CheckedPictures]) -> tuple[DamagedVideo, ...]:
    """Summarise the damaged and doubled frames of each video, in the cameras' order.

    ``session``: session, restricted to the output frames of the reconstruction. ``pictures``: pictures of ranges; the
    ranges of a camera are in order of time. Raises ``InputError`` if the share of damaged frames exceeds
    ``MAX_DAMAGED_SHARE`` in a video; lists all such videos.
    """
    whole = session_timebase(session.times)
    output_frames = session.frames or range(whole.num_frames)
    span = span_s(whole, output_frames.start, output_frames.stop)
    damaged: dict[str, list[int]] = {camera: [] for camera in session.camera_videos}
    changes: dict[str, list[PictureChanges]] = {camera: [] for camera in session.camera_videos}
    for camera, frames, of_range in pictures:
        damaged[camera] += frames.tolist()
        changes[camera].append(of_range)
    doubled = {camera: doubled_frames(join_changes(of_ranges)) for camera, of_ranges in changes.items()}
    videos = tuple(
        DamagedVideo(
            camera=camera,
            file=video.path.name,
            num_damaged=len(numbers),
            num_frames=len(frames_in(session.times[camera], *span)),
            first_s=float(video.time_s[numbers[0]]) if numbers else 0.0,
            last_s=float(video.time_s[numbers[-1]]) if numbers else 0.0,
            doubled_s=tuple(video.time_s[doubled[camera]].tolist()),
        )
        for camera, video in session.camera_videos.items()
        if (numbers := damaged[camera]) or len(doubled[camera])
    )
    if problems := [_problem(video) for video in videos if video.num_damaged > MAX_DAMAGED_SHARE * video.num_frames]:
        raise InputError(problems)
    return videos


def _problem(video: DamagedVideo) -> Problem:
    return Problem(
        VIDEO_DAMAGED,
        f"{video.num_damaged} of {video.num_frames} frames are damaged or can't be decoded, from {video.first_s:.1f} "
        f"to {video.last_s:.1f} s of the video; at most {MAX_DAMAGED_SHARE:.0%} may be.",
        file=video.file,
        camera=video.camera,
        hint="Copy the file again, or cut the damaged part away.",
    )
