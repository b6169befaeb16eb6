"""Videos that commands open, with what their options state of them."""

import inspect
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, get_args, get_type_hints

import typer

from api.cli import options as cli_options
from api.cli.console import shows_help
from pipeline.capture.preflight_record import Clock
from pipeline.core.errors import InputError, Problem
from pipeline.core.options.rules import collecting, require
from pipeline.core.problems.finding_codes import PARAMETER_UNREADABLE, SOURCES
from pipeline.core.problems.session_codes import CAMERA_WITH_TWO_FOLDERS
from pipeline.video.images.files import SEQUENCE

if not shows_help():
    from pipeline.capture.keypoints import KeypointSession, open_keypoints
    from pipeline.capture.own_points_file import with_own_points
    from pipeline.capture.preflight_record import Recording
    from pipeline.capture.session import CaptureSession, Session, open_session


@dataclass(frozen=True, slots=True)
class SourceOptions:
    """Options that state the videos, images or keypoints of a session, as they were typed; ``None``: not given."""

    videos: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="VIDEO|CAMERA=VIDEO",
            help="Folder with one video of each camera, or the videos; or folders or zips of images. CAMERA= states "
            "the camera of a video, or of the next part of its recording. Repeatable.",
            show_default=False,
        ),
    ] = None
    offset: Annotated[
        list[str] | None,
        typer.Option(metavar="CAMERA=SECONDS", help="Time of a video's first frame on the common clock; repeatable."),
    ] = None
    rate: Annotated[
        list[str] | None,
        typer.Option(
            metavar="CAMERA=HZ",
            help="Frames that a camera took in a second, if its video states others, such as slow motion; repeatable.",
        ),
    ] = None
    clock: Annotated[
        str,
        typer.Option(
            metavar="|".join(get_args(Clock)),
            help="Clock of the videos' first frames: --offset, or what the files state, to which it is added.",
        ),
    ] = "declared"
    keypoints: cli_options.KeypointsOption = None
    timestamps: Annotated[
        Path | None, typer.Option(help="Times of the keypoints' frames: CSV with the columns camera, frame, time_s.")
    ] = None
    frame_rate: cli_options.KeypointRateOption = None
    layout: cli_options.LayoutOption = None
    own_points: Annotated[
        Path | None,
        typer.Option(
            help="Rigid objects and bones among points of your own, YAML or JSON; see `multicap help own-points`."
        ),
    ] = None
    pair_by_order: cli_options.PairByOrderOption = False
    units: cli_options.UnitsOption = None
    up: cli_options.UpOption = "z"

    def check(self, *, is_optional: bool = False) -> None:
        """Check that options can be read and go together.

        Raises ``InputError`` with all that are wrong. Without videos and keypoints it raises too, unless they are
        optional.
        """
        with collecting() as collect:
            collect(lambda: cli_options.known_units(self.units))
            collect(lambda: cli_options.known_clock(self.clock))
            collect(lambda: cli_options.known_up(self.up))
            is_given = any((self.videos, self.keypoints, self.timestamps, self.offset, self.rate))
            if is_given or not is_optional:
                collect(lambda: require(self._mixed()))

    def _mixed(self) -> Iterator[Problem]:
        """Problems of options of videos that were given with options of keypoints."""
        if (self.videos is None) == (self.keypoints is None):
            yield Problem(SOURCES, "A capture has either videos or keypoints.", hint="Give one of them.")
        if self.keypoints is None and self.timestamps is not None:
            message = "Timestamps belong to keypoints; videos have their own times."
            yield Problem(SOURCES, message, hint="Omit --timestamps.")
        if self.keypoints is None and self.layout is not None:
            message = "A layout belongs to keypoints; detectors of videos have their own."
            yield Problem(SOURCES, message, hint="Omit --layout.")
        if self.keypoints is None and self.own_points is not None:
            message = "Points of your own belong to keypoints; detectors of videos find people."
            yield Problem(SOURCES, message, hint="Omit --own-points.")
        if self.keypoints is not None and self.offset:
            message = "Offsets belong to videos; keypoints have timestamps."
            yield Problem(SOURCES, message, hint="Omit --offset.")
        if self.keypoints is not None and self.rate:
            message = "Rates of single cameras belong to videos; keypoints have one rate, or timestamps."
            yield Problem(SOURCES, message, hint="State it by --frame-rate, and omit --rate.")

    def open(self, calibration: Path) -> "Session":
        """Open keypoints if they are given, else videos; raises ``InputError`` as the functions of both."""
        return self.open_videos(calibration) if self.keypoints is None else self.open_keypoints(calibration)

    def open_keypoints(self, calibration: Path, *, keeps_poses: bool = True) -> "KeypointSession":
        """Open keypoints; raises ``InputError`` if options can't be read, and as ``pipeline.capture.keypoints``."""
        session = open_keypoints(
            _keypoint_folder(self.keypoints or ()),
            calibration,
            self.timestamps,
            self.frame_rate,
            cli_options.known_units(self.units),
            pair_by_order=self.pair_by_order,
            keeps_poses=keeps_poses,
            up=cli_options.known_up(self.up),
            layout=self.layout,
        )
        return session if self.own_points is None else with_own_points(session, self.own_points)

    def open_videos(self, calibration: Path | None, *, keeps_poses: bool = True) -> "CaptureSession":
        """Open videos, or images; raises ``InputError`` if options can't be read, and as ``open_session``."""
        paths, recordings = _footage(self.videos or (), self.offset, self.rate)
        session = open_session(
            paths[0] if len(paths) == 1 else paths,
            calibration,
            recordings,
            cli_options.known_units(self.units),
            cli_options.known_clock(self.clock),
            self.frame_rate,
            self.pair_by_order,
            keeps_poses=keeps_poses,
            up=cli_options.known_up(self.up),
        )
        if self.frame_rate is not None and all(video.codec != SEQUENCE for video in session.videos):
            message = "A frame rate belongs to keypoints and to images; videos have their own times."
            hint = "Omit --frame-rate; state the rate of a camera by --rate."
            raise InputError([Problem(SOURCES, message, hint=hint)])
        return session


def with_source(*, omits: Collection[str] = ()) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Give a command the options of ``SourceOptions`` in place of its parameter ``source``, but for those it omits."""
    hints = get_type_hints(SourceOptions, include_extras=True)
    options = [
        inspect.Parameter(
            field.name, inspect.Parameter.KEYWORD_ONLY, default=field.default, annotation=hints[field.name]
        )
        for field in fields(SourceOptions)
        if field.name not in omits
    ]
    return cli_options.with_options("source", options, lambda typed: SourceOptions(**typed))


def _keypoint_folder(keypoints: Sequence[Path]) -> Path | Mapping[str, Path]:
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
) -> "tuple[list[Path], list[Recording]]":
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


def parameters(said: Sequence[str], example: str) -> dict[str, float]:
    """NAME=VALUE pairs as numbers by name. Raises ``InputError`` with those that are none."""
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
