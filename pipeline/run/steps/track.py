"""Track people: bodies or poses of all frames to tracks, in one pass in time order. The output is stored people."""

from pipeline.run.engine import stage


@stage.declared(
    stage.ASSOCIATE,
    "Tracking people",
    cut="whole",
    follows=(stage.DETECT, stage.SYNCHRONIZE, stage.REFINE, stage.LENGTHS, stage.POSES),
    choices=("method", "frame_range", "appearance", "tracking", "clustering"),
    interim_of=(stage.DETECT,),
)
def track(task: stage.Task, context: stage.Context) -> stage.Output:
    """Turn bodies or poses of all frames into tracks."""
    from pipeline.association.hands.attach import without_fingers
    from pipeline.core.data.people import Poses3D
    from pipeline.run.engine.detection_source import detection_source
    from pipeline.run.engine.methods import MeasuredBones, association_in, gathered_bodies
    from pipeline.run.engine.stored_people import write_people
    from pipeline.run.engine.wanted_frames import wanted_frames

    on_share = context.on_share(task)
    if context.config.method == "clustering":
        association = association_in(context, wanted_frames(context, context.outline()))
        people = association.link(context.records(stage.POSES, Poses3D), on_share)
        damaged = context.record(stage.LENGTHS, MeasuredBones).damaged
    else:
        bodies, damaged = gathered_bodies(context)
        session = wanted_frames(context, context.outline())
        bodies = without_fingers(bodies, detection_source(context).joints(session))
        people = association_in(context, session).track(bodies, on_share)
        del bodies
    path = context.scratch / "people.npz"
    write_people(path, people, damaged)
    return stage.Output(path)
