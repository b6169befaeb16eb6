"""Find people: in a range of output frames, each instant by itself. The output is a ``Poses3D``."""

from pipeline.core.problems.requests import FRAME_RANGE
from pipeline.run.engine.stage import DETECT, LENGTHS, POSES, REFINE, SYNCHRONIZE, Context, Output, Stage, Task
from pipeline.run.steps.lengths import is_clustering


def find_poses(task: Task, context: Context) -> Output:
    """Find all people in a range of output frames."""
    from pipeline.run.engine.association import MeasuredBones
    from pipeline.run.engine.codec import encode

    session = context.wanted(context.session())
    detected = context.detections.in_range(task, session, task.index, task.frames)
    lengths = context.record(LENGTHS, MeasuredBones).lengths
    frames = context.numbered_from_first(task.frames, session)
    return Output(encode(context.association(session).locate_people(frames, detected, lengths, context.on_unit)))


STAGE = Stage(
    POSES,
    "Find people",
    find_poses,
    cut="ranges",
    follows=(DETECT, SYNCHRONIZE, REFINE, LENGTHS),
    choices=(FRAME_RANGE, "clustering"),
    is_planned=is_clustering,
)
