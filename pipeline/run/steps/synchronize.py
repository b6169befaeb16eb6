"""Synchronise cameras: when the frames of each were taken. The output is a ``Synchronization``."""

from pipeline.core.errors import InputError, Problem
from pipeline.core.problems.finding_codes import SYNC_NEEDS_BODIES
from pipeline.run.engine.stage import DETECT, SYNCHRONIZE, Context, Output, Task, declared


@declared(
    SYNCHRONIZE,
    "Synchronising cameras",
    cut="whole",
    follows=(DETECT,),
    choices=("sync",),
    is_planned=lambda facts, config: config.is_of_people and config.sync == "auto",
)
def synchronize(task: Task, context: Context) -> Output:
    """Measure the clocks of the cameras, from all people of the session and from the sound of its videos."""
    from pipeline.capture.synchronization.session_clocks import listen, measure_clocks
    from pipeline.core.runtime.record_archive import encode
    from pipeline.run.engine.detection_source import detection_source

    detections, session = detection_source(context), context.session()
    if detections.finds_fields:
        message = "Cameras are synchronised from whole bodies; this network finds joints."
        raise InputError([Problem(SYNC_NEEDS_BODIES, message, hint="Choose another detector, or declare offsets.")])
    bodies, joints = detections.bodies(session), detections.joints(session)
    sound = listen(session, context.video)
    return Output(encode(measure_clocks(session, bodies, joints, sound, context.on_share(task))))
