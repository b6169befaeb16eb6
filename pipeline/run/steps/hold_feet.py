"""Hold feet: fitted skeletons on the floor that everybody's feet find. The output of a task is an ``Animation``."""

from pipeline.run.engine.stage import FIT, HOLD, IDENTIFY, REFINE, SYNCHRONIZE, Context, Output, Stage, Task
from pipeline.run.steps.fit import CHOICES


def hold_feet(task: Task, context: Context) -> Output:
    """Finish the motion of a part of the people: feet that stand are held, and hands are fitted."""
    from pipeline.core.data.animation import Animation
    from pipeline.core.progress import split
    from pipeline.motion.skeleton.animate import FittedFeet, FittedPerson, PersonFitter, floor_under
    from pipeline.motion.skeleton.fitting.fit import FitState
    from pipeline.run.engine.codec import RecordArchive, encode

    session = context.wanted(context.outline())
    people = context.people(IDENTIFY).people
    joints = context.detections.joints(session)
    fitter = PersonFitter(session.cameras, session.timebase, joints, context.config, context.offsets())
    feet = list(context.records(FIT, FittedFeet))
    points = [feet[number % len(feet)].points[number // len(feet)] for number in range(len(people.tracks))]
    floor = floor_under([points[number] for number in feet[0].on_floor or ()], session.timebase.frame_rate_hz)
    path = context.scratch / "states.npz"
    path.write_bytes(*context.interim(FIT, slice(task.index, task.index + 1)))
    states = RecordArchive(path)  # one of them at a time is in memory
    on_share, numbers = context.on_share(task), range(len(people.tracks))[STAGE.people(task)]
    finished = [
        fitter.finish(
            FittedPerson(states.read(FitState, place), points[number]),
            people.tracks[number],
            people.observations[number],
            floor,
            on_person,
        )
        for place, (number, on_person) in enumerate(zip(numbers, split(on_share, [1] * len(numbers)), strict=True))
    ]
    on_share(1.0)
    tracks, motions = (track for track, _ in finished), (motion for _, motion in finished)
    return Output(encode(Animation(tuple(tracks), tuple(motions), floor)))


STAGE = Stage(
    HOLD,
    "Hold feet",
    hold_feet,
    cut="people",
    follows=(SYNCHRONIZE, REFINE, IDENTIFY, FIT),
    choices=(*CHOICES, "feet"),
)
