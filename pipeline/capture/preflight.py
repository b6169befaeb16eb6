"""Check a session, or a calibration, in a child process.

``python -m pipeline.capture.preflight (--videos FILE... [--clock CLOCK] [--frame-rate HZ] | --keypoints ZIP...
[--timestamps FILE] [--frame-rate HZ]) --calibration FILE [--recordings JSON] [--units UNITS] [--up AXIS]
[--layout LAYOUT] [--pair-by-order] [--own_points FILE] [--laboratory FILE]``, or ``--points FILE... [--names JSON]
[--frame-rate HZ] [--units UNITS] [--up AXIS]``, prints one JSON object: the session's report, or ``{"problems":
[...]}`` with exit code 2. So a caller can check a session without loading the numeric libraries, and without opening
untrusted files itself.
``--record FILE`` stores the opened session, so that the files need not be examined again. ``--thumbnails FOLDER`` also
checks the cameras against each other and a few pictures of each video, for ``--pictures-s SECONDS``; their small copies
are stored in the folder as ``thumbnail_name`` says.

With a calibration alone it checks that, and prints what it contains. ``--videos`` without ``--calibration``, or with
``--intrinsics`` in its place, belong to a calibration that is to be made.
"""

import argparse
import hashlib
import json
import math
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar, get_args

from pipeline.calibration.board.spec import parse_board
from pipeline.calibration.checks.camera_checks import UP_AXIS_CODES, check_cameras, check_places
from pipeline.calibration.registry import read_contents
from pipeline.calibration.write import encode
from pipeline.capture.camera_files import find_input
from pipeline.capture.keypoints import MAX_JOINTS, KeypointSession, open_keypoints
from pipeline.capture.keypoints_zip import unpack_keypoints
from pipeline.capture.laboratory.laboratory_files import with_laboratory
from pipeline.capture.own_points_file import with_own_points
from pipeline.capture.pictures.sample_pictures import Thumbnail, look_at_pictures
from pipeline.capture.points import open_points, parse_names
from pipeline.capture.preflight_npz import save_record
from pipeline.capture.preflight_record import (
    Clock,
    Preflight,
    PreflightCamera,
    PreflightThumbnail,
    PreflightTimebase,
    Recording,
    thumbnail_name,
)
from pipeline.capture.session import Session, open_session
from pipeline.core.errors import InputError, Problem, printable
from pipeline.core.findings import Finding, documents
from pipeline.core.options.job_choices import UNITS_M, Up
from pipeline.core.problems.finding_codes import CALIBRATION_NOTE
from pipeline.core.problems.request_codes import SESSION_TOO_LARGE
from pipeline.core.problems.session_codes import IMAGES_ARCHIVE
from pipeline.core.runtime.confinement import print_answer
from pipeline.video.frame_rate import OF_TIMES, measured_rate_hz
from pipeline.video.images.files import is_sequence

_Session = TypeVar("_Session", bound=Session)
# Time at which the program began.
_STARTED_S = time.monotonic()


def report(
    session: Session,
    files: Sequence[Sequence[str]],
    units: str | None,
    recordings: Sequence[Recording] = (),
    clock: Clock = "declared",
    up: Up = "z",
) -> Preflight:
    """Build the preflight record of a session; ``files`` are the names of each camera's files."""
    timebase = session.timebase
    media, detected = _media(session, recordings), session.detections if isinstance(session, KeypointSession) else {}
    starts_s = {name: float(times.time_s[0]) if len(times.time_s) else 0.0 for name, times in session.times.items()}
    return Preflight(
        cameras=tuple(
            PreflightCamera(
                name=camera.name,
                file=of_camera[0],
                size_px=camera.size_px,
                frame_rate_hz=_camera_rate_hz(session, camera.name),
                num_frames=len(session.times[camera.name].time_s),
                start_time_s=starts_s[camera.name],
                media_type=media[camera.name][0],
                media_start_s=media[camera.name][1],
                more_files=tuple(of_camera[1:]),
                num_bodies=len(detected[camera.name].frame) if camera.name in detected else None,
                num_joints=detected[camera.name].score.shape[1] if camera.name in detected else None,
            )
            for camera, of_camera in zip(session.cameras, files, strict=True)
        ),
        timebase=PreflightTimebase(timebase.start_time_s, timebase.frame_rate_hz, timebase.num_frames),
        stretches=tuple(session.stretches),
        recordings=tuple(recordings),
        units=units or "m",
        up=up,
        findings=tuple(session.findings),
        clock=clock,
        layout=session.layout,
    )


def _media(session: Session, recordings: Sequence[Recording]) -> Mapping[str, tuple[str | None, float]]:
    """Media type for browsers and time of the first frame in the file, by camera; of keypoints ``None`` and 0."""
    # Players would show a video with wrong times at these.
    corrected = {recording.camera for recording in recordings if recording.frame_rate_hz is not None}
    media: dict[str, tuple[str | None, float]] = {camera.name: (None, 0.0) for camera in session.cameras}
    for camera in session.cameras:
        if (video := session.camera_videos.get(camera.name)) is not None:
            is_corrected = bool(corrected & {camera.name, camera.section})
            media[camera.name] = (None if is_corrected else video.browser_media_type, video.media_start_s)
    return media


def _camera_rate_hz(session: Session, camera: str) -> float:
    """Measured rate of a camera; for keypoints the session's rate, if it is equal or the camera has too few frames."""
    time_s, session_hz = session.times[camera].time_s, session.timebase.frame_rate_hz
    camera_hz = measured_rate_hz(time_s)
    if camera in session.camera_videos:
        return camera_hz
    return session_hz if len(time_s) < 2 or math.isclose(camera_hz, session_hz, rel_tol=1e-6) else camera_hz


def _check_videos(arguments: argparse.Namespace) -> tuple[Preflight, Session]:
    if arguments.photographs and (others := [path for path in arguments.videos if not is_sequence(path)]):
        raise InputError([_no_archive(path) for path in others])
    recordings = _recordings(arguments)
    units, clock = arguments.units, arguments.clock
    session = open_session(
        arguments.videos,
        arguments.intrinsics or arguments.calibration,
        recordings,
        units,
        clock,
        arguments.frame_rate,
        arguments.pair_by_order,
        keeps_poses=arguments.intrinsics is None,
        up=arguments.up,
    )
    if arguments.photographs:  # their numbers are no times
        session = replace(
            session, findings=tuple(finding for finding in session.findings if finding.code not in OF_TIMES)
        )
    session = _with_laboratory(session, arguments)
    files = [[path.name for path in video.paths] for video in session.videos]
    preflight = report(session, files, units, recordings, clock, arguments.up)
    if arguments.thumbnails:
        looked = look_at_pictures(session, max(0.0, arguments.pictures_s - (time.monotonic() - _STARTED_S)))
        stored = [_write_thumbnails(arguments.thumbnails, *numbered) for numbered in enumerate(looked.thumbnails)]
        preflight = replace(preflight, cameras=tuple(map(_with_thumbnails, preflight.cameras, stored)))
        preflight = _with_findings(preflight, [*check_cameras(session.cameras), *looked.findings])
    return preflight, session


def _with_laboratory(session: _Session, arguments: argparse.Namespace) -> _Session:
    """Session with the C3D file of a laboratory, if there is one."""
    if arguments.laboratory is None:
        return session
    facts = json.loads(arguments.laboratory_facts)
    return with_laboratory(session, arguments.laboratory, **facts, up=arguments.up)


def _recordings(arguments: argparse.Namespace) -> list[Recording]:
    return [
        Recording(**{**recording, "more_files": tuple(recording.get("more_files", ()))})
        for recording in json.loads(arguments.recordings)
    ]


def _write_thumbnails(folder: Path, camera: int, thumbnails: Sequence[Thumbnail]) -> tuple[PreflightThumbnail, ...]:
    for number, thumbnail in enumerate(thumbnails):
        (folder / thumbnail_name(camera, number)).write_bytes(thumbnail.content)
    return tuple(
        PreflightThumbnail(thumbnail.time_s, len(thumbnail.content), hashlib.sha256(thumbnail.content).hexdigest())
        for thumbnail in thumbnails
    )


def _with_thumbnails(camera: PreflightCamera, thumbnails: tuple[PreflightThumbnail, ...]) -> PreflightCamera:
    return replace(camera, thumbnails=thumbnails)


def _with_findings(preflight: Preflight, findings: Sequence[Finding]) -> Preflight:
    return replace(preflight, findings=(*preflight.findings, *findings))


def _no_archive(path: Path) -> Problem:
    message, hint = (
        "The file is not a zip archive of photographs.",
        "Send one zip archive for each camera, named as it.",
    )
    return Problem(IMAGES_ARCHIVE, message, file=path.name, hint=hint)


def _check_keypoints(arguments: argparse.Namespace) -> tuple[Preflight, Session]:
    recordings = _recordings(arguments)
    with tempfile.TemporaryDirectory(prefix="multicap-") as folder:
        session = open_keypoints(
            unpack_keypoints(arguments.keypoints, Path(folder)),
            arguments.calibration,
            arguments.timestamps,
            arguments.frame_rate,
            arguments.units,
            arguments.max_joints,
            arguments.pair_by_order,
            recordings=[_of_folder(recording, arguments.keypoints) for recording in recordings],
            up=arguments.up,
            layout=arguments.layout,
        )
    if arguments.own_points:
        session = with_own_points(session, arguments.own_points)
    session = _with_laboratory(session, arguments)
    archives = {path.stem: path.name for path in arguments.keypoints}
    # Parts of an array of all cameras have no archives of their own.
    files = [[archives.get(session.folders[camera.name], arguments.keypoints[0].name)] for camera in session.cameras]
    preflight = report(session, files, arguments.units, recordings, up=arguments.up)
    if arguments.thumbnails:
        preflight = _with_findings(preflight, check_cameras(session.cameras))
    return preflight, session


def _check_points(arguments: argparse.Namespace) -> tuple[Preflight, Session]:
    names = parse_names(arguments.names.encode())
    with tempfile.TemporaryDirectory(prefix="multicap-") as folder:
        zips = [path for path in arguments.points if path.suffix.lower() == ".zip"]
        if zips:
            unpack_keypoints(zips, Path(folder))
        files = [Path(folder) / path.stem if path in zips else path for path in arguments.points]
        session = open_points(files, arguments.frame_rate, arguments.units, arguments.up, names)
    checked = report(session, [], arguments.units, up=arguments.up or "z")
    return replace(checked, names=names), session


def _of_folder(recording: Recording, archives: Sequence[Path]) -> Recording:
    """Recording that names the folder into which its archive is unpacked."""
    archive = None if recording.file is None else find_input(recording.file, archives)
    return recording if archive is None else replace(recording, file=archive.stem)


def _check(arguments: argparse.Namespace) -> dict[str, Any]:
    """Check the session, or the calibration, and build the answer."""
    if arguments.points:
        preflight, session = _check_points(arguments)
    elif not arguments.videos and not arguments.keypoints:
        return _check_calibration(arguments)
    else:
        preflight, session = (_check_videos if arguments.videos else _check_keypoints)(arguments)
        if arguments.laboratory:
            preflight = replace(preflight, laboratory=json.loads(arguments.laboratory_facts))
    if arguments.record:
        with arguments.record.open("wb") as file:
            save_record(session, file)
    return preflight.to_json()


def _check_calibration(arguments: argparse.Namespace) -> dict[str, Any]:
    """Read a calibration: its cameras in metres, what the format says, and doubts about the axis that points up."""
    contents = read_contents(arguments.calibration, arguments.units, arguments.up)
    notes = [Finding(CALIBRATION_NOTE, note, severity="info") for note in contents.notes]
    doubts = [finding for finding in check_places(contents.cameras) if finding.code in UP_AXIS_CODES]
    return {
        "format": printable(contents.format),
        "units": contents.unit or arguments.units or "m",
        "axes": printable(contents.axes),
        "warnings": documents([*notes, *doubts]),
        "text": encode(contents.cameras).decode(),
    }


def main(words: Sequence[str] | None = None) -> int:
    """Run the check with the command line's arguments, or with ``words``; return the exit code."""
    parser = argparse.ArgumentParser(description="Check a capture session.")
    views = parser.add_mutually_exclusive_group()
    views.add_argument("--videos", nargs="+", type=Path)
    views.add_argument("--keypoints", nargs="+", type=Path)
    views.add_argument("--points", nargs="+", type=Path, help="Files of 3D points, or zips of a JSON file a frame.")
    parser.add_argument("--names", default="{}", help="JSON object: joints by names of 3D points.")
    parser.add_argument("--calibration", type=Path)
    parser.add_argument("--intrinsics", type=Path, help="Calibration in place of --calibration; its poses don't count.")
    parser.add_argument("--timestamps", type=Path)
    parser.add_argument("--frame-rate", type=float)
    parser.add_argument("--layout", help="Layout of keypoints whose files do not name their points.")
    parser.add_argument("--own_points", type=Path, help="Rigid objects and bones among own points of keypoints.")
    parser.add_argument("--laboratory", type=Path, help="C3D file of a laboratory beside the cameras.")
    parser.add_argument("--laboratory-facts", default="{}", help="JSON object: clock, channel and place of its axes.")
    parser.add_argument("--recordings", default="[]", help="JSON list of facts about videos or archives.")
    parser.add_argument("--clock", choices=get_args(Clock), default="declared", help="Clock of the videos' starts.")
    parser.add_argument("--units", choices=UNITS_M, help="Unit of lengths in the calibration.")
    parser.add_argument(
        "--up", choices=get_args(Up), help="Axis that points up: z, or told by the people of 3D points."
    )
    parser.add_argument(
        "--max-joints", type=int, default=MAX_JOINTS, help="Limit on the joints of all people in all keypoint files."
    )
    parser.add_argument("--pair-by-order", action="store_true", help="Pair by the order of the files' names.")
    parser.add_argument("--photographs", action="store_true", help="The videos are archives of photographs.")
    parser.add_argument("--board", help="Board that the videos show; its specification is checked.")
    parser.add_argument("--record", type=Path)
    parser.add_argument(
        "--pictures-s",
        type=float,
        default=math.inf,
        help="Time since the start of the program after which no picture is looked at.",
    )
    parser.add_argument("--thumbnails", type=Path, help="Check cameras and pictures too; folder for small copies.")
    arguments = parser.parse_args(words)
    if not arguments.points:
        arguments.up = arguments.up or "z"
    if not (arguments.calibration or arguments.videos or arguments.points):
        parser.error("name a calibration")
    message = "The check of the files needs more memory than the service allows, or stores more."
    too_large = Problem(SESSION_TOO_LARGE, message, hint="Cut the capture into several, or lower its resolution.")

    def check() -> dict[str, Any]:
        if arguments.board:
            parse_board(arguments.board)
        return _check(arguments)

    return print_answer(check, too_large)


if __name__ == "__main__":
    sys.exit(main())
