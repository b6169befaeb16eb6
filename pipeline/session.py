"""Open a capture session: videos and a calibration that fit each other, or everything that is wrong with them."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from pipeline.calibration.registry import read_calibration
from pipeline.data import Camera, FrameTimes
from pipeline.errors import InputError, Problem
from pipeline.video.info import VideoInfo
from pipeline.video.probe import probe_in_children

MIN_CAMERAS = 2

_VIDEO_ENDINGS = frozenset({".mp4", ".mov", ".m4v", ".mkv", ".webm", ".avi", ".ts", ".mts", ".m2ts", ".mpg", ".mpeg"})


@dataclass(frozen=True, slots=True, eq=False)
class CaptureSession:
    """Calibrated cameras and their videos, in the calibration's order.

    Parameters
    ----------
    cameras, videos
        One a view, in the same order.
    times
        When each camera took its frames, on the session's clock; by camera name.
    warnings
        What a person should know, a sentence each.
    """

    cameras: tuple[Camera, ...]
    videos: tuple[VideoInfo, ...]
    times: Mapping[str, FrameTimes]
    warnings: tuple[str, ...]


def open_session(videos: Path | Sequence[Path], calibration: Path) -> CaptureSession:
    """Open a folder of videos, or the videos named, with a calibration.

    Videos count as synchronised at their first frames. A video belongs to the camera of its name, for all videos or for
    none; else videos and cameras are paired in sorted order, with a warning that shows the pairs.

    Raises
    ------
    InputError
        With all problems of all files.
    """
    paths, warnings, problems = _find_videos(videos)
    cameras: tuple[Camera, ...] = ()
    try:
        cameras = read_calibration(calibration)
    except InputError as error:
        problems.extend(error.problems)

    probed = probe_in_children(paths)
    problems.extend(found for found in probed if isinstance(found, Problem))
    infos = {path.stem: found for path, found in zip(paths, probed, strict=True) if isinstance(found, VideoInfo)}
    if cameras:
        pairs = _pair(cameras, [path.stem for path in paths], problems, warnings)
        for camera in cameras:
            video = infos.get(pairs.get(camera.name, ""))
            if video is not None and video.size_px != camera.size_px:
                problems.append(_size_problem(camera, video))
    if problems:
        raise InputError(problems)
    return CaptureSession(
        cameras=cameras,
        videos=tuple(infos[pairs[camera.name]] for camera in cameras),
        times={camera.name: FrameTimes(infos[pairs[camera.name]].time_s) for camera in cameras},
        warnings=tuple(warnings),
    )


def _find_videos(videos: Path | Sequence[Path]) -> tuple[list[Path], list[str], list[Problem]]:
    """The video files, with warnings of what is ignored and problems of what is missing or doubled."""
    warnings: list[str] = []
    problems: list[Problem] = []
    if isinstance(videos, Path) and videos.is_dir():
        files = sorted(path for path in videos.iterdir() if path.is_file() and not path.name.startswith("."))
        paths = [path for path in files if path.suffix.lower() in _VIDEO_ENDINGS]
        warnings.extend(f"{path.name} is ignored: it is no video." for path in files if path not in paths)
    else:
        paths = [videos] if isinstance(videos, Path) else list(videos)
    if len(paths) < MIN_CAMERAS:
        problems.append(
            Problem(
                "too_few_videos",
                f"There {'is one video' if paths else 'are no videos'}; at least {MIN_CAMERAS} are needed.",
                hint="Give one video of each camera.",
            )
        )
    for stem, count in sorted(Counter(path.stem for path in paths).items()):
        if count > 1:
            problems.append(
                Problem("duplicate_video", f"{count} videos have the name {stem}.", file=stem, hint="Rename them.")
            )
    return paths, warnings, problems


def _pair(
    cameras: Sequence[Camera], stems: Sequence[str], problems: list[Problem], warnings: list[str]
) -> dict[str, str]:
    """Name of the video of each camera, by exact name for all of them, or in sorted order for all of them."""
    names = [camera.name for camera in cameras]
    if not set(names) & set(stems) and len(names) == len(stems):
        pairs = dict(zip(sorted(names), sorted(stems), strict=True))
        shown = ", ".join(f"{camera}: {video}" for camera, video in pairs.items())
        warnings.append(f"No video bears the name of a camera. They were paired in sorted order: {shown}.")
        return pairs
    problems.extend(
        Problem(
            "camera_without_video",
            "The calibration has this camera, but no video bears its name.",
            camera=name,
            hint="Add its video, or remove it from the calibration.",
        )
        for name in sorted(set(names) - set(stems))
    )
    problems.extend(
        Problem(
            "video_without_camera",
            "No camera in the calibration has the name of this video.",
            file=stem,
            hint=f"The calibration's cameras are {', '.join(sorted(names))}.",
        )
        for stem in sorted(set(stems) - set(names))
    )
    return {name: name for name in names if name in stems}


def _size_problem(camera: Camera, video: VideoInfo) -> Problem:
    return Problem(
        "size_mismatch",
        f"The video has {video.size_px[0]} x {video.size_px[1]} pixels, the calibration "
        f"{camera.size_px[0]} x {camera.size_px[1]}.",
        file=video.path.name,
        camera=camera.name,
        field="size",
        hint="Calibrate at the size of the videos.",
    )
