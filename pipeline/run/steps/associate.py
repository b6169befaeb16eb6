"""Track people: bodies or poses of all frames to tracks, in one pass in time order. The output is stored people."""

from pipeline.run.engine.stage import (
    ASSOCIATE,
    DETECT,
    LENGTHS,
    POSES,
    REFINE,
    SYNCHRONIZE,
    Context,
    Output,
    Stage,
    Task,
)


def associate(task: Task, context: Context) -> Output:
    """Turn bodies or poses of all frames into tracks."""
    from pipeline.association.hands.attach import without_fingers
    from pipeline.core.data.people import Poses3D
    from pipeline.run.engine.association import MeasuredBones
    from pipeline.run.engine.people import write_people

    on_share = context.on_share(task)
    if context.config.method == "clustering":
        association = context.association(context.wanted(context.outline()))
        people = association.link(context.records(POSES, Poses3D), on_share)
        damaged = context.record(LENGTHS, MeasuredBones).damaged
    else:
        bodies, damaged = context.gathered_bodies()
        session = context.wanted(context.outline())
        bodies = without_fingers(bodies, context.detections.joints(session))
        people = context.association(session).track(bodies, on_share)
        del bodies
    path = context.scratch / "people.npz"
    write_people(path, people, damaged)
    del people
    return Output(path.read_bytes())


STAGE = Stage(
    ASSOCIATE,
    "Track people",
    associate,
    cut="whole",
    follows=(DETECT, SYNCHRONIZE, REFINE, LENGTHS, POSES),
    choices=("method", "frame_range", "appearance", "tracking", "clustering"),
)
