"""Refine calibration: from the people that a first association finds. The output is a ``RefinedCalibration``.

Errors of the session's check that refinement may mend are judged here, with the refined cameras.
"""

from collections.abc import Iterator
from typing import Any

from pipeline.run.engine.stage import CHECK, DETECT, REFINE, SYNCHRONIZE, Context, Output, Task, declared


@declared(
    REFINE,
    "Refining the calibration",
    cut="whole",
    follows=(DETECT, SYNCHRONIZE, CHECK),
    choices=("refine_calibration", "method", "frame_range", "tracking", "clustering"),
    is_planned=lambda facts, config: config.is_of_people and config.refine_calibration == "auto",
)
def refine(task: Task, context: Context) -> Output:
    """Refine the cameras of the session, on measured clocks if they were measured."""
    from pipeline.core.findings import SessionCheck
    from pipeline.core.runtime.record_archive import encode
    from pipeline.run.engine.detection_source import detection_source
    from pipeline.run.engine.methods import association_in
    from pipeline.run.engine.recalibration import refine_from_bodies, refine_from_fields
    from pipeline.run.engine.wanted_frames import from_first, wanted_on_clocks
    from pipeline.run.session_check.verdict import is_deferred, judge_refined
    from pipeline.run.steps.check import check_with

    config, detections, on_share = context.config, detection_source(context), context.on_share(task)
    session = wanted_on_clocks(context, context.session())
    association = association_in(context, session)

    def chunks() -> Iterator[tuple[range, Any]]:
        for number, frames in enumerate(task.cut(context.facts)):
            yield from_first(frames, task.frames), detections.in_range(task, session, number, frames)

    if detections.finds_fields:
        refined = refine_from_fields(association, chunks, on_share)
    else:
        refined = refine_from_bodies(association, detections.bodies(session), detections.joints(session), on_share)
    if is_deferred(context.record(CHECK, SessionCheck), session.cameras, config):
        judge_refined(check_with(task, context, refined.cameras), refined.cameras)
    return Output(encode(refined))
