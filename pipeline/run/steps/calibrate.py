"""Calibrate cameras: find the board in the videos, then make a calibration from its views or from people.

The output of *Finding the board* is a ``BoardViews`` a camera, and the output of *Calibrating cameras* is the
calibration.
"""

import json
from collections.abc import Sequence

from pipeline.core.errors import PipelineError, listed
from pipeline.core.findings import Finding, from_problem
from pipeline.core.options.job_choices import BOARD_FRAMES, CalibrationChoices
from pipeline.run.engine.stage import CALIBRATE, DETECT, FIND_BOARD, LOOK, Context, Output, ResultFile, Task, declared

_MEDIA_TYPES = {".json": "application/json", ".svg": "image/svg+xml"}


@declared(
    FIND_BOARD,
    "Finding the board",
    cut="cameras",
    follows=(),
    choices=("making",),
    is_planned=lambda facts, config: isinstance(config.making, CalibrationChoices) and config.making.board is not None,
    unit="frames",
    reads_videos=True,
    max_frames=BOARD_FRAMES,
)
def find_board(task: Task, context: Context) -> Output:
    """Look for the board in frames of a camera."""
    import numpy as np

    from pipeline.calibration.board.source import frames_to_look_at, look_in_video, photographs_to_look_at
    from pipeline.calibration.board.spec import parse_board
    from pipeline.core.runtime.record_archive import encode
    from pipeline.run.engine.wanted_frames import captured_videos

    session, making, camera = captured_videos(context), context.config.making, task.one_camera
    if not isinstance(making, CalibrationChoices) or making.board is None:
        raise PipelineError("The job looks for no board.")
    starts_s, ends_s = zip(*((times.time_s[0], times.time_s[-1]) for times in session.times.values()), strict=True)
    own_s = session.times[camera].time_s
    frames = frames_to_look_at(own_s, (float(min(starts_s)), float(max(ends_s))), 1.0 / session.timebase.frame_rate_hz)
    if making.has_photographs:
        frames, own_s = photographs_to_look_at(len(own_s)), np.full(len(own_s), np.nan)
    board = parse_board(making.board)
    with context.video(camera):
        views = look_in_video(session.camera_videos[camera], camera, own_s, frames, board, context.on_unit)
    return Output(encode(views))


@declared(
    CALIBRATE,
    "Calibrating cameras",
    cut="whole",
    follows=(LOOK, DETECT, FIND_BOARD),
    choices=("making",),
    is_planned=lambda facts, config: isinstance(config.making, CalibrationChoices),
    is_reusable=False,
)
def calibrate(task: Task, context: Context) -> Output:
    """Make a calibration, its report and its pictures."""
    from pipeline.calibration.board.calibrate_board import calibrate_board
    from pipeline.calibration.board.spec import parse_board
    from pipeline.calibration.board.views import BoardViews
    from pipeline.calibration.people.calibrate_people import calibrate_people
    from pipeline.calibration.report import report_document
    from pipeline.calibration.write import encode
    from pipeline.run.engine.detection_source import detection_source
    from pipeline.run.session_check.check_session import hanging_cameras

    hanging: Sequence[Finding] = ()
    making, on_share = context.config.making, context.on_share(task)
    if not isinstance(making, CalibrationChoices):
        raise PipelineError("The job makes no calibration.")
    if making.board is None:
        session, detections = context.session(), detection_source(context)
        calibration = calibrate_people(
            session.cameras,
            session.times,
            detections.bodies(session),
            detections.joints(session),
            making.stature_m,
            making.has_intrinsics,
            on_share,
            making.known_points,
        )
        hanging = tuple(hanging_cameras(detections.turns_deg))
    else:
        outline = context.outline()
        given = {camera.name: camera for camera in outline.cameras} if making.has_intrinsics else None
        views = list(context.records(FIND_BOARD, BoardViews))
        board, rate_hz = parse_board(making.board), outline.timebase.frame_rate_hz
        calibration = calibrate_board(views, board, given, rate_hz, on_share=on_share, known_points=making.known_points)
    report, text = report_document(calibration), encode(calibration.cameras).decode()
    contents = {
        "calibration.json": text,
        "report.json": json.dumps(report, indent=1) + "\n",
        **calibration.pictures,
    }
    files = []
    for name, content in contents.items():
        path = context.scratch / name
        path.write_text(content, encoding="utf-8")
        kind = path.stem if path.suffix == ".json" else path.suffix.removeprefix(".")
        files.append(ResultFile(name, kind, None, _MEDIA_TYPES[path.suffix], path))
    warnings = tuple(from_problem(problem, "warning") for problem in listed(calibration.warnings))
    made = {"text": text, "report": report}
    return Output(text.encode(), tuple(files), (*warnings, *hanging), calibration=made)
