"""Tell people apart: who is who, from the tracks of the whole session. The output is stored people."""

from pipeline.run.engine import stage
from pipeline.run.steps.redetect import redetects_bodies


@stage.declared(
    stage.IDENTIFY,
    "Matching people across cameras",
    cut="whole",
    follows=(stage.DETECT, stage.SYNCHRONIZE, stage.REFINE, stage.ASSOCIATE, stage.REDETECT),
    choices=("people",),
    interim_of=(stage.DETECT,),
)
def identify(task: stage.Task, context: stage.Context) -> stage.Output:
    """Find out who is who, give people the bodies that were detected again, and each limb one person and one side."""
    from pipeline.association.hands.attach import has_hands
    from pipeline.capture.points import PointSession, unseen
    from pipeline.core.data.detections import Detections
    from pipeline.core.data.people import People
    from pipeline.run.engine.detection_source import detection_source
    from pipeline.run.engine.methods import association_in, gathered_bodies
    from pipeline.run.engine.stored_people import found_people, write_people
    from pipeline.run.engine.wanted_frames import require_kind, wanted_frames

    path = context.scratch / "people.npz"
    if context.facts.has_points:
        points = require_kind(context.session(), PointSession).restricted(context.config.frames)
        people = People(points.people, [unseen(track) for track in points.people])
        write_people(path, people, joints=points.joints)
        context.on_share(task)(1.0)
        return stage.Output(path)
    session = wanted_frames(context, context.outline())
    association, detections = association_in(context, session), detection_source(context)
    joints = detections.joints(session)
    tracked = found_people(context, stage.ASSOCIATE)
    colour = gathered_bodies(context)[0].colour if detections.measures_colours else None
    people = association.assign_identities(tracked.people, colour)
    del colour
    if redetects_bodies(context.facts, context.config):
        people = association.accept_redetected(people, context.records(stage.REDETECT, Detections))
    people = association.assign_limbs(people)
    people = association.find_losses(association.follow_by_one_camera(people, tracked.people.leftovers))
    if has_hands(joints):
        people = association.attach(people, gathered_bodies(context)[0], joints)
    write_people(path, people, tracked.damaged, joints)
    context.on_share(task)(1.0)
    return stage.Output(path)
