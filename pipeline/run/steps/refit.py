"""Fit edited people: each by themselves, on the floor of those who were found. The output is an ``Animation``."""

from dataclasses import replace

from pipeline.run.engine.stage import (
    EDIT,
    HOLD,
    IDENTIFY,
    REFINE,
    REFIT,
    SYNCHRONIZE,
    Context,
    Output,
    Stage,
    Task,
)
from pipeline.run.steps.edit import is_edited
from pipeline.run.steps.fit import CHOICES

# Number in the pieces: edits give a person's frames another number.
_ANYBODY = 0


def refit(task: Task, context: Context) -> Output:
    """Animate a part of the people whom edits changed, unless an earlier task has animated the same frames."""
    from pipeline.core.data.animation import Animation, Floor
    from pipeline.core.progress import split
    from pipeline.motion.skeleton.animate import animate
    from pipeline.run.engine.codec import RecordArchive, decode, encode
    from pipeline.run.engine.editing import renumbered
    from pipeline.run.engine.pieces import Pieces

    session, config, on_share = context.wanted(context.outline()), context.config, context.on_share(task)
    joints, offsets = context.detections.joints(session), context.offsets()
    changed = context.people(EDIT).people
    floor = RecordArchive(*context.outputs(HOLD, slice(1))).find(Floor, "floor")
    pieces = Pieces(task, context)
    numbers = range(len(changed.tracks))[STAGE.people(task)]
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
    return Output(encode(Animation(tuple(tracks), tuple(motions), floor)), pieces=pieces.files)


STAGE = Stage(
    REFIT,
    "Fit edited people",
    refit,
    cut="people",
    follows=(SYNCHRONIZE, REFINE, IDENTIFY, HOLD, EDIT),
    choices=(*CHOICES, "feet"),
    is_planned=is_edited,
    is_of_edits=True,
    pieces_of=REFIT,
)
