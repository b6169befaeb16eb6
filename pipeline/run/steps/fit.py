"""Fit skeletons: one a person, first with free feet, then with feet held on the floor that everybody's feet find.

The output of a task of *Solving skeletons* has the points of the feet of a part of the people, and its interim output
the state of their fits. The output of a task of *Holding feet still* is an ``Animation``.
"""

from functools import cache

from pipeline.run.engine.stage import FIT, HOLD, IDENTIFY, REFINE, SYNCHRONIZE, Context, Output, Task, declared

CHOICES = ("smoothing", "cutoff_hz", "joint_centers")
"""Choices of a fit, and of the fit of people changed by edits."""


@declared(
    FIT,
    "Solving skeletons",
    cut="people",
    follows=(SYNCHRONIZE, REFINE, IDENTIFY),
    choices=CHOICES,
    leaves_interim=lambda config: True,
)
def fit(task: Task, context: Context) -> Output:
    """Fit the skeletons of a part of the people; the first task also finds from whose feet the floor is estimated."""
    from pipeline.association.identity.likenesses import find_likenesses, seen_in
    from pipeline.core.progress import split
    from pipeline.core.runtime.record_archive import encode, save
    from pipeline.motion.skeleton.animate import FittedFeet, PersonFitter
    from pipeline.run.engine.detection_source import detection_source, joint_offsets
    from pipeline.run.engine.stored_people import found_people
    from pipeline.run.engine.wanted_frames import wanted_frames

    session = wanted_frames(context, context.outline())
    people = found_people(context, IDENTIFY).people
    joints = detection_source(context).joints(session)
    fitter = PersonFitter(session.cameras, session.timebase, joints, context.config, joint_offsets(context))
    on_floor = None
    if task.index == 0:
        # Observations stay in their file: one person's at a time are in memory.
        sees = cache(seen_in(people.observations))
        likenesses = find_likenesses(people.tracks, sees, session.cameras, joints, session.timebase.frame_rate_hz)
        on_floor = tuple(likenesses.others(len(people.tracks)))
    on_share, numbers = context.on_share(task), range(len(people.tracks))[fit.people(task)]
    fitted = [
        fitter.fit(people.tracks[number], people.observations[number], on_person)
        for number, on_person in zip(numbers, split(on_share, [1] * len(numbers)), strict=True)
    ]
    on_share(1.0)
    feet = FittedFeet(tuple(person.points for person in fitted), on_floor)
    path = context.scratch / "fits.npz"
    save(tuple(person.state for person in fitted), path)
    return Output(encode(feet), interim=path)


@declared(
    HOLD,
    "Holding feet still",
    cut="people",
    follows=(SYNCHRONIZE, REFINE, IDENTIFY, FIT),
    choices=(*CHOICES, "feet"),
    interim_of=(FIT,),
)
def hold_feet(task: Task, context: Context) -> Output:
    """Finish the motion of a part of the people: feet that stand are held, and hands are fitted."""
    from pipeline.core.data.animation import Animation
    from pipeline.core.progress import split
    from pipeline.core.runtime.record_archive import RecordArchive, save
    from pipeline.motion.skeleton.animate import FittedFeet, FittedPerson, PersonFitter, floor_under
    from pipeline.motion.skeleton.fitting.fit import FitState
    from pipeline.run.engine.detection_source import detection_source, joint_offsets
    from pipeline.run.engine.stored_people import found_people
    from pipeline.run.engine.wanted_frames import wanted_frames

    session = wanted_frames(context, context.outline())
    people = found_people(context, IDENTIFY).people
    joints = detection_source(context).joints(session)
    fitter = PersonFitter(session.cameras, session.timebase, joints, context.config, joint_offsets(context))
    feet = list(context.records(FIT, FittedFeet))
    points = [feet[number % len(feet)].points[number // len(feet)] for number in range(len(people.tracks))]
    floor = floor_under([points[number] for number in feet[0].on_floor or ()], session.timebase.frame_rate_hz)
    path = context.scratch / "states.npz"
    context.copy_output(FIT, task.index, path, is_interim=True)
    states = RecordArchive(path)  # one of them at a time is in memory
    on_share, numbers = context.on_share(task), range(len(people.tracks))[hold_feet.people(task)]
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
    path = context.scratch / "animation.npz"
    save(Animation(tuple(tracks), tuple(motions), floor), path)
    return Output(path)
