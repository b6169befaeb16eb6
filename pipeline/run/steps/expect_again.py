"""Expect leaning bodies once more, by what the first look at them found. The output is a ``Detections`` a camera."""

from pipeline.run.engine.stage import (
    ASSOCIATE,
    EXPECT,
    EXPECT_AGAIN,
    LOOK,
    REDETECT,
    REFINE,
    SYNCHRONIZE,
    Context,
    Output,
    Stage,
    Task,
)
from pipeline.run.steps.redetect import is_redetecting


def expect_again(task: Task, context: Context) -> Output:
    """Find the pictures in which leaning people are elsewhere than they were looked for; none if nobody was found."""
    from pipeline.association.redetection.elsewhere import expected_elsewhere
    from pipeline.association.redetection.expect import expect_leaning
    from pipeline.core.data.detections import Detections
    from pipeline.run.engine.codec import decode, encode, output_records
    from pipeline.run.engine.detections import detection_source
    from pipeline.run.engine.methods import association_in
    from pipeline.run.engine.stored_people import found_people
    from pipeline.run.engine.wanted_frames import wanted_frames

    (content,) = context.outputs(EXPECT)
    looked_for = decode(tuple[Detections, ...], content)
    found = tuple(output_records(context, REDETECT, Detections))
    if not any(len(bodies.frame) for bodies in found):
        return Output(encode(tuple(bodies.within(range(0)) for bodies in looked_for)))
    association, turns_deg = (
        association_in(context, wanted_frames(context, context.outline())),
        detection_source(context).turns_deg,
    )
    people = association.assign_identities(found_people(context, ASSOCIATE).people)
    people = association.assign_limbs(association.accept_redetected(people, found))
    expected = expect_leaning(
        zip(people.tracks, people.observations, strict=True),
        association.cameras,
        association.times,
        association.timebase,
        association.joints,
        turns_deg,
    )
    return Output(encode(expected_elsewhere(expected, looked_for, turns_deg)))


STAGE = Stage(
    EXPECT_AGAIN,
    "Find leaning bodies that are elsewhere",
    expect_again,
    cut="whole",
    follows=(LOOK, SYNCHRONIZE, REFINE, ASSOCIATE, EXPECT, REDETECT),
    choices=("people",),
    is_planned=is_redetecting,
)
