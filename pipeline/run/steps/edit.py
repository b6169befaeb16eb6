"""Edit people: put together the people changed by edits, and fit each of them by themselves on the take's floor.

The output of *Applying edits* is stored people, and the output of a task of *Solving edited people* an ``Animation``.
"""

from dataclasses import replace

from pipeline.core.options.config import ReconstructionConfig
from pipeline.run.engine import stage
from pipeline.run.steps.fit import CHOICES

# Number in the pieces: edits give a person's frames another number.
_ANYBODY = 0


def edit(task: stage.Task, context: stage.Context) -> stage.Output:
    """Put the people together that the edits change."""
    from pipeline.run.engine.edited_people import changed_people, edited_take
    from pipeline.run.engine.stored_people import found_people, write_people
    from pipeline.run.engine.wanted_frames import wanted_frames

    identified = found_people(context, stage.IDENTIFY)
    take = edited_take(identified.spans, context.config, wanted_frames(context, context.outline()).timebase)
    path = context.scratch / "people.npz"
    write_people(path, changed_people(identified.people, identified.spans, take))
    context.on_share(task)(1.0)
    return stage.Output(path.read_bytes())


def refit(task: stage.Task, context: stage.Context) -> stage.Output:
    """Animate a part of the people changed by edits, unless an earlier task has animated the same frames."""
    from pipeline.core.data.animation import Animation, Floor
    from pipeline.core.progress import split
    from pipeline.motion.skeleton.animate import animate
    from pipeline.run.engine.codec import RecordArchive, decode, encode
    from pipeline.run.engine.detection_source import detection_source, joint_offsets
    from pipeline.run.engine.edited_people import renumbered
    from pipeline.run.engine.pieces import Pieces
    from pipeline.run.engine.stored_people import found_people
    from pipeline.run.engine.wanted_frames import wanted_frames

    session, config, on_share = wanted_frames(context, context.outline()), context.config, context.on_share(task)
    joints, offsets = detection_source(context).joints(session), joint_offsets(context)
    changed = found_people(context, stage.EDIT).people
    floor = RecordArchive(*context.outputs(stage.HOLD, slice(1))).find(Floor, "floor")
    pieces = Pieces(task, context)
    numbers = range(len(changed.tracks))[REFIT_STAGE.people(task)]
    fitted = []
    for number, on_person in zip(numbers, split(on_share, [1] * len(numbers)), strict=True):
        track, seen = changed.tracks[number], changed.observations[number]
        key = pieces.key(replace(track, track_id=_ANYBODY), replace(seen, track_id=_ANYBODY))
        content = pieces.find(key)
        if content is None:
            animation = animate(
                [track], [seen], session.cameras, session.timebase, joints, config, on_person, offsets, floor
            )
            path = context.scratch / f"person-{number}.npz"
            path.write_bytes(content := encode(renumbered(animation, _ANYBODY)))
            pieces.keep(key, path)
        fitted.append(renumbered(decode(Animation, content), track.track_id))
        on_person(1.0)
    on_share(1.0)
    tracks, motions = (person.tracks[0] for person in fitted), (person.motions[0] for person in fitted)
    return stage.Output(encode(Animation(tuple(tracks), tuple(motions), floor)), pieces=pieces.files)


def _is_edited(_: stage.SessionFacts, config: ReconstructionConfig) -> bool:
    """Whether a job has edits that say who is where; names change nobody's frames."""
    return config.is_of_people and bool(config.people_edits)


EDIT_STAGE = stage.Stage(
    stage.EDIT,
    "Applying edits",
    edit,
    cut="whole",
    follows=(stage.SYNCHRONIZE, stage.IDENTIFY),
    choices=("edits",),
    is_planned=_is_edited,
    is_of_edits=True,
)
REFIT_STAGE = stage.Stage(
    stage.REFIT,
    "Solving edited people",
    refit,
    cut="people",
    follows=(stage.SYNCHRONIZE, stage.REFINE, stage.IDENTIFY, stage.HOLD, stage.EDIT),
    choices=(*CHOICES, "feet"),
    is_planned=_is_edited,
    is_of_edits=True,
    pieces_of=stage.REFIT,
)
