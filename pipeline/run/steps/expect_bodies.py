"""Expect leaning bodies where detectors miss them or call left right. The output is a ``Detections`` a camera."""

from pipeline.run.engine.stage import ASSOCIATE, EXPECT, LOOK, REFINE, SYNCHRONIZE, Context, Output, Stage, Task
from pipeline.run.steps.redetect import is_redetecting


def expect_bodies(task: Task, context: Context) -> Output:
    """Find the frames of each camera in which people are expected who lean, and their places there."""
    from pipeline.association.redetection.expect import expect_leaning
    from pipeline.run.engine.codec import encode
    from pipeline.run.engine.detections import detection_source
    from pipeline.run.engine.methods import association_in
    from pipeline.run.engine.stored_people import found_people
    from pipeline.run.engine.wanted_frames import wanted_frames

    association = association_in(context, wanted_frames(context, context.outline()))
    # Places of people do not depend on the colours of their clothes, by which `identify` tells them apart, too.
    people = association.assign_identities(found_people(context, ASSOCIATE).people)
    return Output(
        encode(
            expect_leaning(
                zip(people.tracks, people.observations, strict=True),
                association.cameras,
                association.times,
                association.timebase,
                association.joints,
                detection_source(context).turns_deg,
            )
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
