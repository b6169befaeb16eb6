"""Fits of the people whom edits changed: each person by themselves, on the floor of those who were found."""

from dataclasses import replace

from pipeline.data import Animation, Floor
from pipeline.progress import OnShare, split
from pipeline.skeleton.animate import animate
from pipeline.stages.codec import RecordArchive, decode, encode
from pipeline.stages.editing import renumbered
from pipeline.stages.inputs import Context, archive_of_people, used_offsets, wanted_inputs
from pipeline.stages.output import Output
from pipeline.stages.people import StoredPeople
from pipeline.stages.plan import EDIT, FIT, PERSON_PARTS, Task
from pipeline.stages.results.assembly import EDITED
from pipeline.stages.results.pieces import Pieces

# Number in the pieces: edits give a person's frames another number.
_ANYBODY = 0


def refit(task: Task, context: Context, on_share: OnShare) -> Output:
    """Animate a part of the people whom edits changed, unless an earlier task has animated the same frames."""
    session, joints = wanted_inputs(context, context.outline())
    changed = StoredPeople(archive_of_people(context, EDIT, EDITED)).people
    offsets, floor = used_offsets(session, context.config), RecordArchive(*context.outputs(FIT)).find(Floor, "floor")
    pieces = Pieces(task, context)
    numbers = range(task.index, len(changed.tracks), PERSON_PARTS)
    fitted = []
    for number, on_person in zip(numbers, split(on_share, [1] * len(numbers)), strict=True):
        track, seen = changed.tracks[number], changed.observations[number]
        key = pieces.key(replace(track, track_id=_ANYBODY), replace(seen, track_id=_ANYBODY))
        content = pieces.find(key)
        if content is None:
            config, timebase = context.config, session.timebase
            animation = animate([track], [seen], session.cameras, timebase, joints, config, on_person, offsets, floor)
            path = context.scratch / f"person-{number}.npz"
            path.write_bytes(content := encode(renumbered(animation, _ANYBODY)))
            pieces.keep(key, path)
        fitted.append(renumbered(decode(Animation, content), track.track_id))
        on_person(1.0)
    on_share(1.0)
    tracks, motions = (one.tracks[0] for one in fitted), (one.motions[0] for one in fitted)
    return Output(encode(Animation(tuple(tracks), tuple(motions), floor)), pieces=pieces.made)
