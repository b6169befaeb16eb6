"""Open a capture session: videos and a calibration that fit each other, or everything that is wrong with them."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from pipeline.calibration.registry import read_calibration
from pipeline.data import Camera, FrameTimes, Timebase
from pipeline.errors import InputError, Problem
from pipeline.pairing import pair_by_name
from pipeline.video.info import VideoInfo
from pipeline.video.probe import probe_in_children
from pipeline.video.timeline import session_timebase

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

    @property
    def timebase(self) -> Timebase:
        """The output frames."""
        return session_timebase(self.times)


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
        pairs, unpaired, shown = pair_by_name(cameras, [path.stem for path in paths], "video")
        problems += unpaired
        warnings += shown
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
