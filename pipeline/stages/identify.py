"""Tell people apart: who is who, from the tracks of the whole session. The output is stored people."""

from pipeline.stages.redetect import is_redetecting
from pipeline.stages.stage import (
    ASSOCIATE,
    DETECT,
    IDENTIFY,
    REDETECT,
    REDETECT_AGAIN,
    REFINE,
    SYNCHRONIZE,
    Context,
    Output,
    Stage,
    Task,
)


def identify(task: Task, context: Context) -> Output:
    """Find out who is who, give people the bodies that were detected again, and each limb one person and one side."""
    from pipeline.data.detections import Detections
    from pipeline.hands.attach import has_hands
    from pipeline.joints import without_hands
    from pipeline.stages.association import (
        accept_redetected,
        assign_identities,
        assign_limbs,
        attach,
        follow_by_one_camera,
    )
    from pipeline.stages.people import write_people

    session = context.wanted(context.outline())
    joints, tracked = context.detections.joints(session), context.people(ASSOCIATE)
    body = without_hands(joints)
    colour = context.gathered_bodies()[0].colour if context.detections.measures_colours else None
    people = assign_identities(session, tracked.people, body, context.config, colour)
    del colour
    if is_redetecting(context.facts, context.config):
        people = accept_redetected(session, people, context.records(REDETECT, Detections), body, context.config)
        found_elsewhere = tuple(context.records(REDETECT_AGAIN, Detections))
        if any(len(bodies.frame) for bodies in found_elsewhere):
            # They were expected of people whose limbs were assigned.
            people = assign_limbs(session, people, body, context.config)
            people = accept_redetected(session, people, found_elsewhere, body, context.config)
    people = assign_limbs(session, people, body, context.config)
    people = follow_by_one_camera(session, people, tracked.people.leftovers, context.config)
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
    follows=(DETECT, SYNCHRONIZE, REFINE, ASSOCIATE, REDETECT, REDETECT_AGAIN),
    choices=("people",),
)
