"""Tell people apart: who is who, from the tracks of the whole session. The output is stored people."""

from pipeline.stages.stage import ASSOCIATE, DETECT, IDENTIFY, REFINE, SYNCHRONIZE, Context, Output, Stage, Task


def identify(task: Task, context: Context) -> Output:
    """Find out who is who, and then attach people's hands."""
    from pipeline.hands.attach import has_hands
    from pipeline.joints import without_hands
    from pipeline.stages.association import assign_identities, attach
    from pipeline.stages.people import write_people

    session = context.wanted(context.outline())
    joints, tracked = context.detections.joints(session), context.people(ASSOCIATE)
    colour = context.gathered_bodies()[0].colour if context.detections.measures_colours else None
    people = assign_identities(session, tracked.people, without_hands(joints), context.config, colour)
    del colour
    if has_hands(joints):
        people = attach(session, people, context.gathered_bodies()[0], joints, context.config)
    path = context.scratch / "people.npz"
    write_people(path, people, tracked.damaged)
    del people
    context.on_share(task)(1.0)
    return Output(path.read_bytes())


STAGE = Stage(
    IDENTIFY,
    "Tell people apart",
    identify,
    cut="whole",
    follows=(DETECT, SYNCHRONIZE, REFINE, ASSOCIATE),
    choices=("people",),
)
