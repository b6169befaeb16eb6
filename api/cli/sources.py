"""Videos that commands open, with what their options state of them."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from pipeline.calibration.contents import Units, Up
from pipeline.capture.keypoints import open_keypoints
from pipeline.capture.preflight_record import Clock
from pipeline.capture.recordings import Recording
from pipeline.capture.session import CaptureSession, Session, open_session
from pipeline.errors import InputError, Problem
from pipeline.problem_codes.commands import PARAMETER_UNREADABLE, SOURCES
from pipeline.problem_codes.sessions import CAMERA_WITH_TWO_FOLDERS
from pipeline.video.images.files import SEQUENCE

VideosOption = Annotated[
    list[Path] | None,
    typer.Option(
        metavar="VIDEO|CAMERA=VIDEO",
        help="Folder with one video of each camera, or the videos; or folders or zips of images. CAMERA= states the "
        "camera of a video, or of the next part of its recording. Repeatable.",
        show_default=False,
    ),
]
OffsetOption = Annotated[
    list[str] | None,
    typer.Option(metavar="CAMERA=SECONDS", help="Time of a video's first frame on the common clock; repeatable."),
]
RateOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="CAMERA=HZ",
        help="Frames that a camera took in a second, if its video states others, such as slow motion; repeatable.",
    ),
]


def open_source(
    videos: Sequence[Path] | None,
    keypoints: Sequence[Path] | None,
    calibration: Path,
    timestamps: Path | None,
    offset: Sequence[str] | None = None,
    rate: Sequence[str] | None = None,
    units: Units | None = None,
    clock: Clock = "declared",
    frame_rate: float | None = None,
    pair_by_order: bool = False,
    up: Up = "z",
) -> Session:
    """Open keypoints if a folder of these is given, else videos; raises ``InputError`` as the functions of both.

    The options are those of ``open_footage`` and ``open_keypoints``, of which ``check_sources`` knows the right ones.
    """
    if keypoints is not None:
        folder = keypoint_folder(keypoints)
        return open_keypoints(folder, calibration, timestamps, frame_rate, units, pair_by_order=pair_by_order, up=up)
    return open_footage(videos or [], calibration, offset, rate, units, clock, frame_rate, pair_by_order, up=up)


def open_footage(
    videos: Sequence[Path],
    calibration: Path | None,
    offset: Sequence[str] | None = None,
    rate: Sequence[str] | None = None,
    units: Units | None = None,
    clock: Clock = "declared",
    frame_rate: float | None = None,
    pair_by_order: bool = False,
    keeps_poses: bool = True,
    up: Up = "z",
) -> CaptureSession:
    """Open videos, or images, with what options state of them.

    Parameters
    ----------
    videos
        Files, folders, and ``CAMERA=VIDEO`` of those whose camera is stated.
    offset, rate
        ``CAMERA=NUMBER`` of each option.
    frame_rate
        Rate of images.
    pair_by_order, keeps_poses, up
        See ``open_session``.

    Raises
    ------
    InputError
        If the options can't be read, and as ``open_session``.
    """
    paths, recordings = _footage(videos, offset, rate)
    files = paths[0] if len(paths) == 1 else paths
    session = open_session(
        files, calibration, recordings, units, clock, frame_rate, pair_by_order, keeps_poses=keeps_poses, up=up
    )
    if frame_rate is not None and all(video.codec != SEQUENCE for video in session.videos):
        message = "A frame rate belongs to keypoints and to images; videos have their own times."
        hint = "Omit --frame-rate; state the rate of a camera by --rate."
        raise InputError([Problem(SOURCES, message, hint=hint)])
    return session


def keypoint_folder(keypoints: Sequence[Path]) -> Path | Mapping[str, Path]:
    """The folder of all cameras, or the folders by camera that are stated as ``CAMERA=FOLDER``.

    Raises ``InputError`` if both are given, or several of one kind for the same.
    """
    stated = [stated_camera(folder) for folder in keypoints]
    cameras = [camera for camera, _ in stated if camera is not None]
    if len(stated) == 1 and not cameras:
        return stated[0][1]
    problems = [
        Problem(CAMERA_WITH_TWO_FOLDERS, "Two folders are stated for this camera.", camera=camera, hint="State one.")
        for camera in dict.fromkeys(cameras)
        if cameras.count(camera) > 1
    ]
    if len(cameras) < len(stated):
        message = "Keypoints are in one folder of all cameras, or in a folder that is stated for each camera."
        problems.append(
            Problem(SOURCES, message, hint="Give --keypoints FOLDER, or --keypoints CAMERA=FOLDER for each.")
        )
    if problems:
        raise InputError(problems)
    return {camera: folder for camera, folder in stated if camera is not None}


def stated_camera(video: Path) -> tuple[str | None, Path]:
    """Camera and path of ``CAMERA=PATH``; no camera for a file or folder that has this name as a whole."""
    camera, sign, path = str(video).partition("=")
    return (camera.strip(), Path(path)) if sign and not video.exists() else (None, video)


def _footage(
    videos: Sequence[Path], offset: Sequence[str] | None, rate: Sequence[str] | None
) -> tuple[list[Path], list[Recording]]:
    """Files, and what is stated of the cameras."""
    paths: list[Path] = []
    stated: dict[str, list[str]] = {}
    for video in videos:
        camera, path = stated_camera(video)
        paths.append(path)
        if camera is not None:
            stated.setdefault(camera, []).append(str(path))
    recordings = {camera: Recording(camera, file, more_files=tuple(more)) for camera, (file, *more) in stated.items()}
    for camera, seconds in parameters(offset or [], "cam_2=0.48").items():
        recordings[camera] = replace(recordings.get(camera, Recording(camera)), offset_s=seconds)
    for camera, rate_hz in parameters(rate or [], "cam_2=240").items():
        recordings[camera] = replace(recordings.get(camera, Recording(camera)), frame_rate_hz=rate_hz)
    return paths, list(recordings.values())


def check_sources(
    videos: Sequence[Path] | None,
    keypoints: Sequence[Path] | None,
    timestamps: Path | None,
    offset: Sequence[str] | None,
    rate: Sequence[str] | None,
) -> None:
    """Raise ``InputError`` if options of videos and of keypoints are mixed, or neither is given."""
    problems = []
    if (videos is None) == (keypoints is None):
        problems.append(Problem(SOURCES, "A session has either videos or keypoints.", hint="Give one of them."))
    if keypoints is None and timestamps is not None:
        message = "Timestamps belong to keypoints; videos have their own times."
        problems.append(Problem(SOURCES, message, hint="Omit --timestamps."))
    if keypoints is not None and offset:
        message = "Offsets belong to videos; keypoints have timestamps."
        problems.append(Problem(SOURCES, message, hint="Omit --offset."))
    if keypoints is not None and rate:
        message = "Rates of single cameras belong to videos; keypoints have one rate, or timestamps."
        problems.append(Problem(SOURCES, message, hint="State it by --frame-rate, and omit --rate."))
    if problems:
        raise InputError(problems)


def parameters(said: Sequence[str], example: str) -> dict[str, float]:
    """NAME=VALUE pairs as numbers by name.

    Raises ``InputError`` with those that are none.
    """
    changes: dict[str, float] = {}
    problems = []
    for text in said:
        name, _, value = text.partition("=")
        try:
            changes[name.strip()] = float(value)
        except ValueError:
            hint = f"Write it as {example}."
            problems.append(Problem(PARAMETER_UNREADABLE, f"{text!r} is not NAME=NUMBER.", hint=hint))
    if problems:
        raise InputError(problems)
    return changes
