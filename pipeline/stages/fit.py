"""Fit skeletons: one a person. The output is an ``Animation``."""

from functools import cache

from pipeline.stages.stage import FIT, IDENTIFY, REFINE, SYNCHRONIZE, Context, Output, Stage, Task

CHOICES = ("smoothing", "cutoff_hz", "feet", "joint_centers")
"""Choices of a fit, and of the fit of people whom edits changed."""


def fit(task: Task, context: Context) -> Output:
    """Animate everybody, on the floor that their feet find."""
    from pipeline.likenesses.find import find_likenesses, seen_in
    from pipeline.skeleton.animate import animate
    from pipeline.stages.codec import encode

    session = context.wanted(context.outline())
    people = context.people(IDENTIFY).people
    joints = context.detections.joints(session)
    # Observations stay in their file: those of one person at a time are in memory.
    sees = cache(seen_in(people.observations))
    likenesses = find_likenesses(people.tracks, sees, session.cameras, joints, session.timebase.frame_rate_hz)
    animation = animate(
        people.tracks,
        people.observations,
        session.cameras,
        session.timebase,
        joints,
        context.config,
        context.on_share(task),
        context.offsets(),
        on_floor=likenesses.others(len(people.tracks)),
    )
    return Output(encode(animation))


STAGE = Stage(
    FIT,
    "Fit skeletons",
    fit,
    cut="whole",
    follows=(SYNCHRONIZE, REFINE, IDENTIFY),
    choices=CHOICES,
)
