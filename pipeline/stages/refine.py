"""Refine calibration: from the people that a first association finds. The output is a ``RefinedCalibration``."""

from collections.abc import Iterator
from typing import Any

from pipeline.stages.stage import DETECT, REFINE, SYNCHRONIZE, Context, Output, Stage, Task


def refine(task: Task, context: Context) -> Output:
    """Refine the cameras of the session, on measured clocks if they were measured."""
    from pipeline.stages.codec import encode
    from pipeline.stages.context import from_first
    from pipeline.stages.refinement import refine_from_bodies, refine_from_fields

    config, detections, on_share = context.config, context.detections, context.on_share(task)
    session = context.on_clocks(context.session())
    joints = detections.joints(session)

    def chunks() -> Iterator[tuple[range, Any]]:
        for number, frames in enumerate(task.cut(context.facts)):
            yield from_first(frames, task.frames), detections.in_range(task, session, number, frames)

    if detections.finds_fields:
        return Output(encode(refine_from_fields(session, chunks, joints, config, on_share)))
    return Output(encode(refine_from_bodies(session, detections.bodies(session), joints, config, on_share)))


STAGE = Stage(
    REFINE,
    "Refine calibration",
    refine,
    cut="whole",
    follows=(DETECT, SYNCHRONIZE),
    choices=("refine_calibration", "method", "frame_range", "tracking", "clustering"),
    is_planned=lambda facts, config: config.is_of_people and config.refine_calibration == "auto",
)
