"""Calibrate cameras: from the views of a board, or from the people of a session. The output is the calibration."""

import json
from collections.abc import Sequence

from pipeline.core.errors import PipelineError, listed
from pipeline.core.findings import Finding
from pipeline.core.options.job_choices import CalibrationChoices
from pipeline.run.engine.stage import CALIBRATE, DETECT, FIND_BOARD, LOOK, Context, Output, ResultFile, Stage, Task

_MEDIA_TYPES = {".json": "application/json", ".svg": "image/svg+xml"}


def calibrate(task: Task, context: Context) -> Output:
    """Make a calibration, its report and its pictures."""
    from pipeline.calibration.board.calibrate import calibrate_board
    from pipeline.calibration.board.spec import parse_board
    from pipeline.calibration.board.views import BoardViews
    from pipeline.calibration.people.calibrate import calibrate_people
    from pipeline.calibration.report import report_document
    from pipeline.calibration.write import encodings
    from pipeline.run.preflight.hanging import hanging_cameras

    hanging: Sequence[Finding] = ()
    making, on_share = context.config.making, context.on_share(task)
    if not isinstance(making, CalibrationChoices):
        raise PipelineError("The job makes no calibration.")
    if making.board is None:
        session = context.session()
        calibration = calibrate_people(
            session.cameras,
            session.times,
            context.detections.bodies(session),
            context.detections.joints(session),
            making.stature_m,
            making.has_intrinsics,
            on_share,
            making.known_points,
        )
        hanging = tuple(hanging_cameras(context.detections.turns_deg))
    else:
        outline = context.outline()
        given = {camera.name: camera for camera in outline.cameras} if making.has_intrinsics else None
        views = list(context.records(FIND_BOARD, BoardViews))
        board, rate_hz = parse_board(making.board), outline.timebase.frame_rate_hz
        calibration = calibrate_board(views, board, given, rate_hz, on_share=on_share, known_points=making.known_points)
    report, texts = report_document(calibration), encodings(calibration.cameras)
    contents = {
        "calibration.json": texts["multicap"],
        "report.json": json.dumps(report, indent=1) + "\n",
        **calibration.pictures,
    }
    files = []
    for name, content in contents.items():
        path = context.scratch / name
        path.write_text(content, encoding="utf-8")
        kind = path.stem if path.suffix == ".json" else path.suffix.removeprefix(".")
        files.append(ResultFile(name, kind, None, _MEDIA_TYPES[path.suffix], path))
    warnings = tuple(
        Finding(problem.code, str(problem), problem.camera, hint=problem.hint)
        for problem in listed(calibration.warnings)
    )
    made = {"files": texts, "report": report}
    return Output(texts["multicap"].encode(), tuple(files), (*warnings, *hanging), calibration=made)


STAGE = Stage(
    CALIBRATE,
    "Calibrate cameras",
    calibrate,
    cut="whole",
    follows=(LOOK, DETECT, FIND_BOARD),
    choices=("making",),
    is_planned=lambda facts, config: isinstance(config.making, CalibrationChoices),
    is_reusable=False,
)
