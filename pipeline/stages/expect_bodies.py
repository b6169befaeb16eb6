"""Expect leaning bodies where detectors miss them or call left right. The output is a ``Detections`` a camera."""

from pipeline.stages.redetect import is_redetecting
from pipeline.stages.stage import ASSOCIATE, EXPECT, LOOK, REFINE, SYNCHRONIZE, Context, Output, Stage, Task


def expect_bodies(task: Task, context: Context) -> Output:
    """Find the frames of each camera in which people are expected who lean, and their places there."""
    from pipeline.joints import without_hands
    from pipeline.redetection.expect import expect_leaning
    from pipeline.stages.association import assign_identities
    from pipeline.stages.codec import encode

    session, detections = context.wanted(context.outline()), context.detections
    joints = without_hands(detections.joints(session))
    # Places of people do not depend on the colours of their clothes, by which `identify` tells them apart, too.
    people = assign_identities(session, context.people(ASSOCIATE).people, joints, context.config)
    cameras = session.cameras, session.times, session.timebase
    return Output(
        encode(
            expect_leaning(zip(people.tracks, people.observations, strict=True), *cameras, joints, detections.turns_deg)
        )
    )


STAGE = Stage(
    EXPECT,
    "Find leaning bodies",
    expect_bodies,
    cut="whole",
    follows=(LOOK, SYNCHRONIZE, REFINE, ASSOCIATE),
    choices=("people",),
    is_planned=is_redetecting,
)
