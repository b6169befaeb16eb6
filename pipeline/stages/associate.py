"""Track people: bodies or poses of all frames to tracks, in one pass in time order. The output is stored people."""

from pipeline.stages.stage import (
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
    from pipeline.data.people import Poses3D
    from pipeline.hands.attach import without_fingers
    from pipeline.joints import without_hands
    from pipeline.stages.association import MeasuredBones, link, track
    from pipeline.stages.people import write_people

    config, on_share = context.config, context.on_share(task)
    if config.method == "clustering":
        session = context.wanted(context.outline())
        joints = without_hands(context.detections.joints(session))
        people = link(session, context.records(POSES, Poses3D), joints, config, on_share)
        damaged = context.record(LENGTHS, MeasuredBones).damaged
    else:
        bodies, damaged = context.gathered_bodies()
        session = context.wanted(context.outline())
        bodies = without_fingers(bodies, context.detections.joints(session))
        people = track(session, bodies, config, on_share)
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
