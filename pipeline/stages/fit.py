"""Fit skeletons: one a person. The output is an ``Animation``."""

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
    # Windows of all observations are asked for again and again, a track but once.
    in_memory = tuple(people.observations)
    joints = context.detections.joints(session)
    likenesses = find_likenesses(
        people.tracks, seen_in(in_memory), session.cameras, joints, session.timebase.frame_rate_hz
    )
    animation = animate(
        people.tracks,
        in_memory,
        session.cameras,
        session.timebase,
        joints,
        context.config,
        context.on_share(task),
        context.offsets(),
        on_floor=likenesses.others(len(in_memory)),
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
