"""Check the session: by the people at a few instants. The output is a ``SessionCheck``.

A session with errors is refused here, after its detections are stored and before anybody is associated.
"""

from dataclasses import replace

from pipeline.run.engine.stage import CHECK, DETECT, LOOK, SYNCHRONIZE, Context, Output, Stage, Task


def check(task: Task, context: Context) -> Output:
    """Check the session as it was given, on measured clocks if they were measured."""
    from pipeline.run.engine.codec import encode
    from pipeline.run.preflight.hanging import hanging_cameras
    from pipeline.run.preflight.verdict import judge
    from pipeline.run.steps.session_check import check_session

    checked = check_session(task, context)
    checked = replace(checked, findings=(*checked.findings, *hanging_cameras(context.detections.turns_deg)))
    return Output(encode(judge(checked, context.session().cameras, context.config)))


STAGE = Stage(
    CHECK,
    "Check the session",
    check,
    cut="whole",
    follows=(LOOK, DETECT, SYNCHRONIZE),
    choices=("frame_range", "force"),
)
