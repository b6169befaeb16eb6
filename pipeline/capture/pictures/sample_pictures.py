"""Look at a few pictures of each video of a session: findings about them, and small copies of them as evidence.

Decoders run in child processes with limits (``pipeline.video``); only arrays of pixels come back.
"""

import math
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float

from pipeline.capture.pictures import figures as picture_figures
from pipeline.capture.session import CaptureSession
from pipeline.core.errors import ChildError, InputError
from pipeline.core.findings import Finding, Severity, from_problem
from pipeline.core.problems.finding_codes import (
    PICTURE_BLURRED,
    PICTURE_DARK,
    PICTURE_FROZEN,
    PICTURES_LEFT_OUT,
    SAME_VIDEO,
)
from pipeline.video.container import reading_s
from pipeline.video.decode import decode
from pipeline.video.info import VideoInfo

# In a picture with so many dark pixels even what is bright is dark.
_DARK_SHARE = 0.98
# Width of edges from which on hands and feet are lost: a person of a third of the picture has wrists of 0.5 % of it,
# and a network that reduces the picture to 640 pixels sees edges of 2 pixels. Small pictures have coarser edges.
_BLUR_SHARE, _BLUR_PX = 0.003, 2.0
# Change of a cell, 2 % of the picture's longer side, in grey levels: codecs of low quality change it by up to 10, a
# person of a tenth of the picture's height, of common contrast, by 30.
STILL = 12.0
# Time for which a picture must stand still, as a share of the camera's time and in seconds.
_FROZEN_SHARE, _FROZEN_S = 0.5, 1.0
_MIN_SAME = 3

PICTURES = "pictures"
"""Name of the evidence that lists pictures of the camera, by their numbers."""


@dataclass(frozen=True, slots=True, eq=False)
class CameraPictures:
    """Figures of some pictures of a camera."""

    camera: str  # Name of the camera
    time_s: Float[np.ndarray, " pictures"]  # Times of the pictures on the session's clock, ascending
    figures: tuple[picture_figures.PictureFigures, ...]  # Figures of each picture

    @property
    def middle(self) -> int:
        """Number of the picture in the middle."""
        return len(self.figures) // 2


def check_pictures(cameras: Sequence[CameraPictures]) -> list[Finding]:
    """Check the pictures of each camera.

    Cameras without pictures are left out. The evidence ``pictures`` of a finding has numbers of pictures of the camera.
    """
    findings: list[Finding] = []
    for camera in cameras:
        if dark := list(_check_dark(camera)):
            # A dark picture has no edges, and does not move.
            findings += dark
        elif camera.figures:
            findings += [*_check_blurred(camera), *_check_frozen(camera, cameras)]
    return findings


def is_dark(figures: picture_figures.PictureFigures) -> bool:
    """True if a picture is too dark for people to be seen."""
    return figures.dark_share >= _DARK_SHARE


def _check_dark(camera: CameraPictures) -> Iterator[Finding]:
    dark = [number for number, picture in enumerate(camera.figures) if is_dark(picture)]
    if 2 * len(dark) > len(camera.figures):
        share = float(np.median([camera.figures[number].dark_share for number in dark]))
        message = (
            f"The picture is too dark: {_percent(share)} of it is darker than 16 % of white, in {len(dark)} of "
            f"{len(camera.figures)} pictures."
        )
        hint = "Light the scene, open the aperture or expose longer; or brighten the video before."
        yield Finding(
            PICTURE_DARK, message, camera.camera, "warning", hint, {"dark_share": share, **_seen(camera, dark)}
        )


def _check_blurred(camera: CameraPictures) -> Iterator[Finding]:
    blurred = [
        number
        for number, picture in enumerate(camera.figures)
        if picture.blur_share >= _BLUR_SHARE and picture.blur_px >= _BLUR_PX
    ]
    if 2 * len(blurred) > len(camera.figures):
        share = float(np.median([camera.figures[number].blur_share for number in blurred]))
        message = (
            f"The picture is blurred: its sharpest edges are {100 * share:.2g} % of its longer side wide, in "
            f"{len(blurred)} of {len(camera.figures)} pictures."
        )
        hint = "Focus on the place where people are, clean the lens, or send the video as the camera recorded it."
        yield Finding(
            PICTURE_BLURRED, message, camera.camera, "warning", hint, {"blur_share": share, **_seen(camera, blurred)}
        )


def _check_frozen(camera: CameraPictures, cameras: Sequence[CameraPictures]) -> Iterator[Finding]:
    first, last = _longest_still(camera)
    start_s, stop_s = float(camera.time_s[first]), float(camera.time_s[last])
    whole_s = float(camera.time_s[-1] - camera.time_s[0])
    if last - first + 1 < _MIN_SAME or stop_s - start_s < max(_FROZEN_S, _FROZEN_SHARE * whole_s):
        return
    moving = [other.camera for other in cameras if other is not camera and _moves(other, start_s, stop_s)]
    if moving:
        message = (
            f"The picture stays the same from {start_s:.1f} to {stop_s:.1f} s, while {moving[0]} sees motion: the "
            "video is frozen, or no person is in its view."
        )
        hint = "Look at the video; export it again, or leave the camera out."
        seen = _seen(camera, [first, last])
        evidence = {"start_s": start_s, "stop_s": stop_s, "other_camera": moving[0], **seen}
        yield Finding(PICTURE_FROZEN, message, camera.camera, "warning", hint, evidence)


def _longest_still(camera: CameraPictures) -> tuple[int, int]:
    """First and last picture of the longest time in which no picture differs from the first one."""
    best = (0, 0)
    for first, picture in enumerate(camera.figures):
        last = first
        while last + 1 < len(camera.figures) and _is_still(picture, camera.figures[last + 1]):
            last += 1
        if camera.time_s[last] - camera.time_s[first] > camera.time_s[best[1]] - camera.time_s[best[0]]:
            best = first, last
    return best


def _is_still(first: picture_figures.PictureFigures, second: picture_figures.PictureFigures) -> bool:
    return picture_figures.largest_change(first.cells, second.cells) < STILL


def _moves(camera: CameraPictures, start_s: float, stop_s: float) -> bool:
    """True if a camera sees motion within a time."""
    inside = [
        picture for time_s, picture in zip(camera.time_s, camera.figures, strict=True) if start_s <= time_s <= stop_s
    ]
    return any(not _is_still(inside[0], picture) for picture in inside[1:])


def _seen(camera: CameraPictures, numbers: Sequence[int]) -> dict[str, Any]:
    """Evidence of pictures: at most two of them, and how many there are."""
    return {"num_pictures": len(camera.figures), PICTURES: sorted({numbers[0], numbers[-1]})}


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"


NUM_PICTURES = 8
"""Largest number of pictures of a camera."""
THUMBNAIL_SIDE_PX = 320
"""Largest side of a thumbnail."""

# Pixels that are decoded at most for the pictures of a video with few keyframes: 600 frames of 1920 x 1080.
_MAX_DECODED_PX = 600 * 1920 * 1080
# Limit on the computing time of a decoder of a small file, and on the wait for one picture.
_MAX_S = 20.0
_MIN_S = 0.1
_DECODERS_AT_ONCE = 2
_JPEG_QUALITY = 80


@dataclass(frozen=True, slots=True)
class Thumbnail:
    """Small copy of a picture."""

    time_s: float  # Time of the picture on the session's clock
    content: bytes  # JPEG whose longer side is at most 320 pixels


@dataclass(frozen=True, slots=True)
class PicturesCheck:
    """Findings about pictures, whose evidence ``pictures`` has numbers of thumbnails of the camera."""

    findings: tuple[Finding, ...]
    thumbnails: tuple[tuple[Thumbnail, ...], ...]  # Thumbnails of each camera of the session, ascending in time


@dataclass(frozen=True, slots=True)
class _Looked:
    """Pictures of a camera; findings if its video could not be decoded; whether the time was over before its end."""

    pictures: CameraPictures
    frames: tuple[int, ...]
    thumbnails: tuple[Thumbnail, ...]
    problems: tuple[Finding, ...]
    is_left_out: bool


def look_at_pictures(session: CaptureSession, budget_s: float = math.inf) -> PicturesCheck:
    """Check a few pictures of each camera of a session.

    A video that can't be decoded within the limits gives a finding. After ``budget_s`` no further picture is looked at.
    A finding says of how many cameras pictures were left out, for lack of time or because their decoder was ended from
    outside.
    """
    deadline_s = time.monotonic() + budget_s
    names = [camera.name for camera in session.cameras]

    def look(camera: str, video: VideoInfo) -> _Looked:
        return _look(session, camera, video, deadline_s)

    with ThreadPoolExecutor(_DECODERS_AT_ONCE) as pool:
        try:
            looked = list(pool.map(look, names, session.videos))
            seen = [camera.pictures for camera in looked]
            alike = similar_views(seen) if time.monotonic() < deadline_s else []
            copies = list(pool.map(lambda pair: _compare(session, looked, pair[0], pair[1], deadline_s), alike))
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    findings = [finding for camera in looked for finding in camera.problems]
    findings += [*check_pictures(seen), *(copy for copy in copies if copy is not None)]
    if num_left := sum(camera.is_left_out for camera in looked):
        message = (
            f"The service was busy: it had no time or memory to look at all pictures of {num_left} of {len(looked)} "
            "cameras. This says nothing about the videos."
        )
        hint = "Send the capture again when the service is less busy to have all pictures looked at."
        findings.append(Finding(PICTURES_LEFT_OUT, message, None, "info", hint, {"num_cameras": num_left}))
    return PicturesCheck(tuple(findings), tuple(camera.thumbnails for camera in looked))


def _look(session: CaptureSession, camera: str, video: VideoInfo, deadline_s: float) -> _Looked:
    time_s = session.times[camera].time_s
    frames: list[int] = []
    figures: list[picture_figures.PictureFigures] = []
    thumbnails: list[Thumbnail] = []
    problems: list[Finding] = []
    is_left_out = time.monotonic() >= deadline_s
    try:
        for number, image_rgb in () if is_left_out else _decoded(video, frames_to_look_at(video), deadline_s):
            if is_left_out := time.monotonic() >= deadline_s:
                break
            frames.append(number)
            figures.append(picture_figures.measure_figures(image_rgb))
            thumbnails.append(Thumbnail(float(time_s[number]), _encode(image_rgb)))
    except InputError as error:
        # The decoder was stopped, or had no time to start.
        is_left_out = time.monotonic() >= deadline_s
        listed = () if is_left_out else error.problems
        # Detection allows for some damaged frames, which these may be.
        severity: Severity = "warning" if figures else "error"
        problems += [from_problem(replace(problem, camera=camera), severity) for problem in listed]
    except ChildError:
        # The decoder was ended from outside, such as for lack of memory: no reason to refuse the session.
        is_left_out = True
    pictures = CameraPictures(camera, time_s[frames], tuple(figures))
    return _Looked(pictures, tuple(frames), tuple(thumbnails), tuple(problems), is_left_out)


def _compare(
    session: CaptureSession, looked: Sequence[_Looked], first: int, later: int, deadline_s: float
) -> Finding | None:
    """Compare two cameras with similar views at the same times since the starts of their files."""
    one, other = session.videos[first], session.videos[later]
    of_first = looked[first]
    ends_s = float(other.time_s[-1])
    known = [number for number, frame in enumerate(of_first.frames) if one.time_s[frame] <= ends_s]
    chosen = [known[int((part + 0.5) * len(known) / MIN_INSTANTS)] for part in range(MIN_INSTANTS)] if known else []
    if len(set(chosen)) < MIN_INSTANTS:
        return None
    figures = []
    try:
        for number in chosen:
            frame = int(np.argmin(np.abs(other.time_s - one.time_s[of_first.frames[number]])))
            figures += [
                picture_figures.measure_figures(image_rgb) for _, image_rgb in _decoded(other, [frame], deadline_s)
            ]
    except (InputError, ChildError):
        return None
    if len(figures) < MIN_INSTANTS:
        return None
    known_figures = [of_first.pictures.figures[number] for number in chosen]
    return same_video(of_first.pictures, looked[later].pictures, known_figures, figures)


def frames_to_look_at(video: VideoInfo) -> list[int]:
    """Frames of a video in the middle of equal parts, ascending: keyframes where there are enough of them.

    Only keyframes can be decoded alone. In a video with few of them the frames are from its beginning, as far as
    decoding all frames before them is quick.
    """
    keyframes = np.flatnonzero(np.isin(video.pts, video.keyframe_pts))
    wanted = _middles(video.num_frames)
    near = sorted({int(keyframes[np.argmin(np.abs(keyframes - frame))]) for frame in wanted}) if len(keyframes) else []
    if 2 * len(near) > len(wanted):
        return near
    width, height = video.stored_size_px
    return _middles(min(video.num_frames, max(1, _MAX_DECODED_PX // (width * height))))


def _middles(num_frames: int) -> list[int]:
    return sorted({int((part + 0.5) * num_frames / NUM_PICTURES) for part in range(NUM_PICTURES)})


def _decoded(video: VideoInfo, frames: Sequence[int], deadline_s: float) -> Iterator[tuple[int, np.ndarray]]:
    limit_s = min(_MAX_S + sum(map(reading_s, video.paths)), max(_MIN_S, deadline_s - time.monotonic()))
    with closing(decode(video, frames[0], frames[-1] + 1, only=frames, limit_s=limit_s)) as pictures:
        yield from pictures


def _encode(image_rgb: np.ndarray) -> bytes:
    small = picture_figures.reduced(np.ascontiguousarray(image_rgb), THUMBNAIL_SIDE_PX)
    options = [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY]
    is_encoded, content = cv2.imencode(".jpg", cv2.cvtColor(small, cv2.COLOR_RGB2BGR), options)
    if not is_encoded:
        raise RuntimeError("OpenCV can't write JPEG")
    return content.tobytes()


# Correlation of the detail of two views: a camera with itself at other times is 0.7 to 1, since people cover
# parts of it; two cameras have 0 up to chance, unless the place is symmetric.
_SAME_VIEW = 0.5
# Correlation of the changes between the same instants.
_SAME_MOTION = 0.6
# Changes of fewer instants may be alike by chance.
MIN_INSTANTS = 3


def similar_views(cameras: Sequence[CameraPictures]) -> list[tuple[int, int]]:
    """Pairs of cameras with similar views, as numbers; for each camera the earlier one that is most alike."""
    views = [_view(camera) for camera in cameras]
    pairs = []
    for later, view in enumerate(views):
        alike = {
            earlier: picture_figures.correlation(view, other)
            for earlier, other in enumerate(views[:later])
            if view is not None and other is not None and view.shape == other.shape
        }
        best = max(alike, key=lambda number: alike[number], default=None)
        if best is not None and alike[best] >= _SAME_VIEW:
            pairs.append((best, later))
    return pairs


def _view(camera: CameraPictures) -> Float[np.ndarray, "rows columns"] | None:
    """Detail of what stands still in a camera's view; ``None`` if there is none."""
    views = [picture.view for picture in camera.figures if not is_dark(picture)]
    still = picture_figures.detail(np.median(views, axis=0)) if views else np.zeros((1, 1))
    return still if still.std() >= picture_figures.DETAIL_MIN else None


def same_video(
    first: CameraPictures,
    later: CameraPictures,
    of_first: Sequence[picture_figures.PictureFigures],
    of_later: Sequence[picture_figures.PictureFigures],
) -> Finding | None:
    """Compare the changes of two cameras with similar views.

    ``of_first`` and ``of_later`` are figures of their pictures at the same times since the starts of their files, at
    least three. Returns a finding about ``later``; ``None`` if the cameras see other motion.
    """
    if len(of_first) < MIN_INSTANTS or of_first[0].cells.shape != of_later[0].cells.shape:
        return None
    changes = [
        np.diff(np.array([picture.cells for picture in of_camera]), axis=0) for of_camera in (of_first, of_later)
    ]
    stands_still = [
        all(picture_figures.largest_change(of_camera[0].cells, picture.cells) < STILL for picture in of_camera)
        for of_camera in (of_first, of_later)
    ]
    # The same view is the same video if nothing moves.
    similarity = 1.0 if all(stands_still) else picture_figures.correlation(*changes)
    if similarity < _SAME_MOTION:
        return None
    message = f"The pictures are like the pictures of {first.camera}: one video may have been given twice."
    evidence = {
        "other_camera": first.camera,
        "similarity": similarity,
        "num_pictures": len(of_first),
        PICTURES: [later.middle],
    }
    # Cameras side by side see nearly the same: the people decide, whose points are the same in one video alone.
    return Finding(SAME_VIDEO, message, later.camera, "warning", "Give each camera its own.", evidence)
