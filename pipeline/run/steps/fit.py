"""Fit skeletons: one a person, before feet are held.

The output of a task has the points of the feet of a part of the people: the floor is that of everybody. The interim
output has the state of their fits.
"""

from functools import cache

from pipeline.run.engine.stage import FIT, IDENTIFY, REFINE, SYNCHRONIZE, Context, Output, Stage, Task

CHOICES = ("smoothing", "cutoff_hz", "joint_centers")
"""Choices of a fit, and of the fit of people whom edits changed."""


def fit(task: Task, context: Context) -> Output:
    """Fit the skeletons of a part of the people; the first task also finds from whose feet the floor is estimated."""
    from pipeline.association.identity.likenesses.find import find_likenesses, seen_in
    from pipeline.core.progress import split
    from pipeline.motion.skeleton.animate import FittedFeet, PersonFitter
    from pipeline.run.engine.codec import encode

    session = context.wanted(context.outline())
    people = context.people(IDENTIFY).people
    joints = context.detections.joints(session)
    fitter = PersonFitter(session.cameras, session.timebase, joints, context.config, context.offsets())
    on_floor = None
    if task.index == 0:
        # Observations stay in their file: those of one person at a time are in memory.
        sees = cache(seen_in(people.observations))
        likenesses = find_likenesses(people.tracks, sees, session.cameras, joints, session.timebase.frame_rate_hz)
        on_floor = tuple(likenesses.others(len(people.tracks)))
    on_share, numbers = context.on_share(task), range(len(people.tracks))[STAGE.people(task)]
    fitted = [
        fitter.fit(people.tracks[number], people.observations[number], on_person)
        for number, on_person in zip(numbers, split(on_share, [1] * len(numbers)), strict=True)
    ]
    on_share(1.0)
    feet = FittedFeet(tuple(person.points for person in fitted), on_floor)
    return Output(encode(feet), interim=encode(tuple(person.state for person in fitted)))


STAGE = Stage(
    FIT,
    "Fit skeletons",
    fit,
    cut="people",
    follows=(SYNCHRONIZE, REFINE, IDENTIFY),
    choices=CHOICES,
    leaves_interim=lambda config: True,
)
