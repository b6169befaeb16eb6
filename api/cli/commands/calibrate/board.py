"""`multicap calibrate board`: cameras from videos or photographs of a board."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated

import typer
from rich.progress import Progress

from api.cli.commands.calibrate.written import POINTS_HELP, require_outputs, show_made, write_made
from api.cli.console import JsonOption, console, reporting, warn
from api.cli.sources import SourceOptions, with_source
from pipeline.calibration.board.calibrate import calibrate_board
from pipeline.calibration.board.source import (
    find_photographs,
    frames_to_look_at,
    look_in_photographs,
    look_in_video,
)
from pipeline.calibration.board.spec import FORMS, Board, parse_board
from pipeline.calibration.board.views import BoardViews
from pipeline.calibration.known_points.table import read_known_points
from pipeline.calibration.registry import read_intrinsics
from pipeline.capture.keypoint_files.timestamps import times_from_file
from pipeline.capture.session import CaptureSession
from pipeline.core.data.cameras import Camera
from pipeline.core.errors import InputError, Problem
from pipeline.core.problems.findings import SOURCES
from pipeline.core.problems.sessions import CAMERA_UNKNOWN


@with_source(omits=("clock", "keypoints", "timestamps", "frame_rate", "units", "up"))
def command(
    *,
    board: Annotated[
        str,
        typer.Option(metavar="BOARD", help=f"{FORMS}. Of a chessboard COLSxROWS are inner corners, else squares."),
    ],
    out: Annotated[Path, typer.Option(help="Calibration to write: .json, .toml or .yml.")],
    source: SourceOptions,
    timestamps: Annotated[
        Path | None,
        typer.Option(
            help="Times of the videos' frames, if they are not those of the videos: CSV with the columns camera, frame "
            "(from 0), time_s."
        ),
    ] = None,
    images: Annotated[
        Path | None, typer.Option(help="Folder of photographs, with a subfolder for each camera: intrinsics only.")
    ] = None,
    intrinsics: Annotated[
        Path | None, typer.Option(help="Calibration whose intrinsics are kept; its poses are ignored.")
    ] = None,
    floor_time: Annotated[
        float | None,
        typer.Option(help="Second at which the board lies on the floor. Default: the longest time it lies still."),
    ] = None,
    world_points: Annotated[Path | None, typer.Option(help=POINTS_HELP)] = None,
    report: Annotated[Path | None, typer.Option(help="Folder for the report and the pictures of coverage.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Calibrate cameras from videos or photographs of a chessboard or a ChArUco board."""
    with reporting(as_json):
        found = parse_board(board)
        require_outputs(out, report)
        known_points = read_known_points(world_points) if world_points is not None else ()
        if (source.videos is None) == (images is None):
            raise InputError(
                [Problem(SOURCES, "A board is filmed or photographed.", hint="Give --videos or --images.")]
            )
        if timestamps is not None and (images is not None or source.offset or source.rate):
            message = "Timestamps are of videos, and hold their offsets and rates."
            raise InputError([Problem(SOURCES, message, hint="Give either --timestamps, or --offset and --rate.")])
        with Progress(console=console, disable=as_json, transient=True) as progress:
            if source.videos is not None:
                session = source.open_videos(intrinsics, keeps_poses=False)
                for sentence in () if as_json else session.warnings:
                    warn(sentence)
                if timestamps is not None:
                    session = timed(session, timestamps)
                views = list(in_videos(session, found, progress))
                named, rate_hz = {camera.name: camera for camera in session.cameras}, session.timebase.frame_rate_hz
            else:
                views = list(_in_photographs(images or Path(), found, progress))
                named, rate_hz = {} if intrinsics is None else _named(intrinsics, views), 0.0
            task = progress.add_task("Calibrate cameras", total=1.0)
            made = calibrate_board(
                views,
                found,
                named if intrinsics else None,
                rate_hz,
                floor_time,
                lambda share: progress.update(task, completed=share),
                known_points,
            )
        write_made(made, out, report)
    show_made(made, out, as_json)


def timed(session: CaptureSession, timestamps: Path) -> CaptureSession:
    """Session with the times of a file for the frames of its videos; raises ``InputError`` if they don't serve."""
    problems: list[Problem] = []
    frames = {camera: range(len(times.time_s)) for camera, times in session.times.items()}
    times, _ = times_from_file(frames, timestamps, problems)
    if problems:
        raise InputError(problems)
    return replace(session, times=times)


def in_videos(session: CaptureSession, board: Board, progress: Progress) -> Iterator[BoardViews]:
    """Views of the board in the videos of a session, camera by camera."""
    times_s = [times.time_s for times in session.times.values()]
    span_s = (
        min(float(frame_times[0]) for frame_times in times_s),
        max(float(frame_times[-1]) for frame_times in times_s),
    )
    interval_s = 1.0 / session.timebase.frame_rate_hz
    for camera, video in zip(session.cameras, session.videos, strict=True):
        own_s = session.times[camera.name].time_s
        frames = frames_to_look_at(own_s, span_s, interval_s)
        task = progress.add_task(f"Find the board: {camera.name}", total=len(frames))
        yield look_in_video(video, camera.name, own_s, frames, board, partial(progress.advance, task))


def _in_photographs(folder: Path, board: Board, progress: Progress) -> Iterator[BoardViews]:
    for camera, paths in find_photographs(folder).items():
        task = progress.add_task(f"Find the board: {camera}", total=len(paths))
        yield look_in_photographs(camera, paths, board, partial(progress.advance, task))


def _named(intrinsics: Path, views: list[BoardViews]) -> dict[str, Camera]:
    """Cameras of a calibration file by name, which must be those of the photographs."""
    cameras = {camera.name: camera for camera in read_intrinsics(intrinsics).cameras}
    problems = [
        Problem(CAMERA_UNKNOWN, "The calibration has no camera of this name.", file=intrinsics.name, camera=view.camera)
        for view in views
        if view.camera not in cameras
    ]
    if problems:
        raise InputError(problems)
    return cameras
