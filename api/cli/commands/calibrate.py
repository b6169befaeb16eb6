"""`multicap calibrate`: make a calibration from a board, from people, or from known points of a scene."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer
from rich import progress as rich_progress

from api.cli import console as terminal
from api.cli.options import SizeOption, UpOption, checked, known_up, stated_sizes, with_choices
from api.cli.sources import SourceOptions, with_source
from pipeline.core.errors import InputError, Problem
from pipeline.core.options.job_choices import BOARD_FORM, MAX_STATURE_M, MAX_STATURES, MIN_STATURE_M, POINT_COLUMNS
from pipeline.core.problems.finding_codes import SOURCES
from pipeline.core.problems.session_codes import CALIBRATION_FORMAT, CAMERA_UNKNOWN
from pipeline.core.progress import Progress
from pipeline.run.engine.stage import CALIBRATE

if not terminal.shows_help():
    from pipeline.calibration.board.calibrate_board import calibrate_board
    from pipeline.calibration.board.source import (
        find_photographs,
        frames_to_look_at,
        look_in_photographs,
        look_in_video,
    )
    from pipeline.calibration.board.spec import Board, parse_board
    from pipeline.calibration.board.views import BoardViews
    from pipeline.calibration.known_points.fit import read_known_points
    from pipeline.calibration.known_points.scene import calibrate_scene, scene_cameras
    from pipeline.calibration.people.calibrate_people import calibrate_people
    from pipeline.calibration.registry import read_intrinsics
    from pipeline.calibration.report import CalibrationResult, report_document
    from pipeline.calibration.write import ENCODERS
    from pipeline.capture.keypoint_files.timestamps import times_from_file
    from pipeline.capture.keypoints import KeypointSession
    from pipeline.capture.session import CaptureSession
    from pipeline.core.data.cameras import Camera
    from pipeline.detection.entries import detection_joints
    from pipeline.run.engine.local import detect_people

POINTS_HELP = f"Points that determine the world: CSV with the columns {', '.join(POINT_COLUMNS)}, a line for each view."
"""Help of the option that names a table of known points."""

_REPORT = "report.json"
_PERCENT = 100

app = typer.Typer(help="Calibrations: make one from a board, from people, or from known points.", no_args_is_help=True)


@app.command("board")
@with_source(omits=("clock", "keypoints", "timestamps", "frame_rate", "units", "up", "own_points"))
def from_board(
    *,
    board: Annotated[
        str,
        typer.Option(metavar="BOARD", help=f"{BOARD_FORM}. Of a chessboard COLSxROWS are inner corners, else squares."),
    ],
    out: Annotated[Path, typer.Option(help="Calibration to write: .json, .toml or .yml.")],
    source: SourceOptions,
    timestamps: Annotated[
        Path | None,
        typer.Option(
            help="Times of the videos' frames, if the videos state others: CSV with the columns camera, frame "
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
    as_json: terminal.JsonOption = False,
) -> None:
    """Calibrate cameras from videos or photographs of a chessboard or a ChArUco board."""
    with terminal.reporting(as_json):
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
        with rich_progress.Progress(console=terminal.console, disable=as_json, transient=True) as progress:
            if source.videos is not None:
                session = source.open_videos(intrinsics, keeps_poses=False)
                if not as_json:
                    terminal.show_session(session.findings, session.layout)
                if timestamps is not None:
                    session = timed(session, timestamps)
                views = list(in_videos(session, found, progress))
                named, rate_hz = {camera.name: camera for camera in session.cameras}, session.timebase.frame_rate_hz
            else:
                views = list(_in_photographs(images or Path(), found, progress))
                named, rate_hz = {} if intrinsics is None else _named(intrinsics, views), 0.0
            task = progress.add_task("Calibrating cameras", total=1.0)
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


def timed(session: "CaptureSession", timestamps: Path) -> "CaptureSession":
    """Session with the times of a file for the frames of its videos; raises ``InputError`` if they don't serve."""
    problems: list[Problem] = []
    frames = {camera: range(len(times.time_s)) for camera, times in session.times.items()}
    times, _ = times_from_file(frames, timestamps, problems)
    if problems:
        raise InputError(problems)
    return replace(session, times=times)


def in_videos(session: "CaptureSession", board: "Board", progress: rich_progress.Progress) -> "Iterator[BoardViews]":
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
        task = progress.add_task(f"Finding the board: {camera.name}", total=len(frames))
        yield look_in_video(video, camera.name, own_s, frames, board, partial(progress.advance, task))


def _in_photographs(folder: Path, board: "Board", progress: rich_progress.Progress) -> "Iterator[BoardViews]":
    for camera, paths in find_photographs(folder).items():
        task = progress.add_task(f"Finding the board: {camera}", total=len(paths))
        yield look_in_photographs(camera, paths, board, partial(progress.advance, task))


def _named(intrinsics: Path, views: "list[BoardViews]") -> "dict[str, Camera]":
    """Cameras of a calibration file by name, which must be the cameras of the photographs."""
    cameras = {camera.name: camera for camera in read_intrinsics(intrinsics).cameras}
    problems = [
        Problem(CAMERA_UNKNOWN, "The calibration has no camera of this name.", file=intrinsics.name, camera=view.camera)
        for view in views
        if view.camera not in cameras
    ]
    if problems:
        raise InputError(problems)
    return cameras


@app.command("people")
@with_choices("profile", "detector")
@with_source(omits=("clock", "units", "up", "own_points"))
def from_people(
    *,
    stature_m: Annotated[
        list[float],
        typer.Option(
            "--stature-m",
            min=MIN_STATURE_M,
            max=MAX_STATURE_M,
            metavar="M",
            help="Stature of the people in metres; may be given once for each person.",
        ),
    ],
    out: Annotated[Path, typer.Option(help="Calibration to write: .json, .toml or .yml.")],
    source: SourceOptions,
    intrinsics: Annotated[
        Path | None,
        typer.Option(
            help="Calibration whose intrinsics are kept; its poses are ignored. Default: focal lengths are estimated."
        ),
    ] = None,
    world_points: Annotated[Path | None, typer.Option(help=POINTS_HELP)] = None,
    chosen: Mapping[str, Any],
    report: Annotated[Path | None, typer.Option(help="Folder for the report.")] = None,
    as_json: terminal.JsonOption = False,
) -> None:
    """Calibrate cameras from people of known stature who walk about: no board."""
    with terminal.reporting(as_json), terminal.StageBars(visible=not as_json) as bars:
        require_outputs(out, report)
        known_points = read_known_points(world_points) if world_points is not None else ()
        config = checked(chosen, source.check)
        problems = []
        if source.keypoints is not None and intrinsics is None:
            message = "Keypoints don't tell the size of the pictures."
            problems.append(Problem(SOURCES, message, hint="Give --intrinsics too."))
        if len(stature_m) > MAX_STATURES:
            problems.append(Problem(SOURCES, f"At most {MAX_STATURES} statures are taken.", field="stature_m"))
        if problems:
            raise InputError(problems)
        session: CaptureSession | KeypointSession
        if source.keypoints is not None and intrinsics is not None:
            session = source.open_keypoints(intrinsics, keeps_poses=False)
            detections, joints = session.detections, session.joints
        else:
            session = source.open_videos(intrinsics, keeps_poses=False)
            detections = detect_people(session, config, bars.update, has_poses=False)
            joints = detection_joints(config)
        if not as_json:
            terminal.show_session(session.findings, session.layout)
        made = calibrate_people(
            session.cameras,
            session.times,
            detections,
            joints,
            stature_m,
            intrinsics is not None,
            lambda share: bars.update(Progress(CALIBRATE, round(_PERCENT * share), _PERCENT)),
            known_points,
        )
        write_made(made, out, report)
    show_made(made, out, as_json)


@app.command("scene")
@with_source(omits=("clock", "keypoints", "timestamps", "frame_rate", "units", "up", "offset", "rate", "own_points"))
def from_scene(
    *,
    points: Annotated[
        Path,
        typer.Option(help=f"Known points: CSV with the columns {', '.join(POINT_COLUMNS)}, a line for each mark."),
    ],
    out: Annotated[Path, typer.Option(help="Calibration to write: .json, .toml or .yml.")],
    source: SourceOptions,
    size: SizeOption = None,
    intrinsics: Annotated[
        Path | None,
        typer.Option(
            help="Calibration whose intrinsics are kept; its poses are ignored. Default: lenses are estimated from "
            "the points."
        ),
    ] = None,
    up: UpOption = "z",
    report: Annotated[Path | None, typer.Option(help="Folder for the report.")] = None,
    as_json: terminal.JsonOption = False,
) -> None:
    """Calibrate cameras from points with known coordinates, marked in one picture of each camera."""
    with terminal.reporting(as_json):
        require_outputs(out, report)
        sizes_px, problems = stated_sizes(size or ())
        if source.videos is not None and size:
            problems.append(Problem(SOURCES, "Videos contain their sizes.", hint="Omit --size."))
        if problems:
            raise InputError(problems)
        known_points = read_known_points(points)
        if source.videos is not None:
            cameras: Sequence[Camera] = source.open_videos(intrinsics, keeps_poses=False).cameras
        else:
            lenses = None if intrinsics is None else read_intrinsics(intrinsics).cameras
            cameras = scene_cameras(known_points, sizes_px, lenses)
        made = calibrate_scene(cameras, known_points, intrinsics is not None, known_up(up))
        write_made(made, out, report)
    if not as_json:
        errors_px = {(camera.name, point.name): point.error_px for camera in made.by_camera for point in camera.points}
        names = [camera.name for camera in made.by_camera]
        terminal.print_table(
            ("point", *(f"{name}, px" for name in names)),
            (
                (point.name, *(_shown(errors_px.get((name, point.name)), "", 1) for name in names))
                for point in known_points
            ),
        )
    show_made(made, out, as_json)


def require_outputs(out: Path, report: Path | None) -> None:
    """Raise ``InputError`` for an ending that no calibration has, ``PipelineError`` for files that can't be written."""
    if out.suffix.lower() not in ENCODERS:
        message = f"--out must end with one of {', '.join(ENCODERS)}."
        raise InputError([Problem(CALIBRATION_FORMAT, message, file=out.name)])
    terminal.require_writable(out, report and report / _REPORT)


def write_made(made: "CalibrationResult", out: Path, report: Path | None) -> None:
    """Write a calibration, and its report with its pictures if a folder is given.

    Raises ``PipelineError`` if a file can't be written.
    """
    files = {out: ENCODERS[out.suffix.lower()](made.cameras)}
    if report is not None:
        files[report / _REPORT] = (json.dumps(report_document(made), indent=1) + "\n").encode()
        files |= {report / name: picture.encode() for name, picture in made.pictures.items()}
    for path, content in files.items():
        with terminal.writing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)


def show_made(made: "CalibrationResult", out: Path, as_json: bool) -> None:
    """Show the report of a calibration."""
    document = report_document(made)
    if as_json:
        terminal.emit(document | {"file": str(out)})
        return
    terminal.print_table(
        ("camera", "views", "reprojection error", "focal length", "sigma", "position sigma"),
        (
            (
                camera["name"],
                str(camera["num_views"]),
                _shown(camera["reprojection_error_px"], "px", 2),
                _shown(camera["focal_px"], "px", 1),
                _shown(camera["focal_sigma_percent"], "%", 2),
                _shown(camera["position_sigma_mm"], "mm", 1),
            )
            for camera in document["cameras"]
        ),
    )
    terminal.console.print(f"World: {made.world}")
    for warning in made.warnings:
        terminal.warn(str(warning))
    if not made.has_extrinsics:
        terminal.warn(
            "The file has intrinsics only. Give it to `multicap calibrate board --intrinsics` to find the poses."
        )
    terminal.console.print(f"{len(made.cameras)} cameras in {out}")


def _shown(value: float | None, unit: str, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f} {unit}".strip()
