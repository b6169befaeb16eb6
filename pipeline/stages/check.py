"""Check the session: by the people at a few instants. The output is a ``SessionCheck``."""

from dataclasses import replace
from functools import partial

from pipeline.findings import SessionCheck
from pipeline.stages.stage import CHECK, DETECT, LOOK, SYNCHRONIZE, Context, Output, Stage, Task


def check(task: Task, context: Context) -> Output:
    """Check the session as it was given, on measured clocks if they were measured."""
    from pipeline.preflight.hanging import hanging_cameras
    from pipeline.stages.codec import encode

    checked = _check_people(task, context)
    return Output(
        encode(replace(checked, findings=(*checked.findings, *hanging_cameras(context.detections.turns_deg))))
    )


def _check_people(task: Task, context: Context) -> SessionCheck:
    from pipeline.preflight.session import check_bodies, check_detections, with_clocks
    from pipeline.synchronization.session import on_measured_clocks

    session, clocks, detections = context.session(), context.clocks(), context.detections
    joints, parts = detections.joints(session), task.cut(context.facts).parts
    if clocks is not None:
        bodies = detections.bodies(session)
        return check_bodies(on_measured_clocks(session, clocks), bodies, joints, parts)
    near = partial(detections.near, task, session)
    checked = check_detections(session, near, joints, parts)
    return checked if detections.finds_fields else with_clocks(checked, session, near, joints, parts)


STAGE = Stage(
    CHECK,
    "Check the session",
    check,
    cut="whole",
    follows=(LOOK, DETECT, SYNCHRONIZE),
    choices=("frame_range",),
)
