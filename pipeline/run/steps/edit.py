"""Edit people: put together the people changed by edits, and fit each of them by themselves on the take's floor.

The output of *Applying edits* is stored people, and the output of a task of *Solving edited people* an ``Animation``.
"""

from pipeline.core.options.config import ReconstructionConfig
from pipeline.run.engine import stage
from pipeline.run.steps.fit import CHOICES


def _is_edited(_: stage.SessionFacts, config: ReconstructionConfig) -> bool:
    """Return whether a job has edits of frames; names change no frames."""
    return config.is_of_people and bool(config.people_edits)


@stage.declared(
    stage.EDIT,
    "Applying edits",
    cut="whole",
    follows=(stage.SYNCHRONIZE, stage.IDENTIFY),
    choices=("edits",),
    is_planned=_is_edited,
    is_of_edits=True,
)
def edit(task: stage.Task, context: stage.Context) -> stage.Output:
    """Put the people together that the edits change."""
    from pipeline.run.engine.edited_people import applied_edits, changed_people
    from pipeline.run.engine.stored_people import found_people, write_people

    identified = found_people(context, stage.IDENTIFY)
    take = applied_edits(context, identified.spans)
    path = context.scratch / "people.npz"
    write_people(path, changed_people(identified.people, identified.spans, take))
    context.on_share(task)(1.0)
    return stage.Output(path)


@stage.declared(
    stage.REFIT,
    "Solving edited people",
    cut="people",
    follows=(stage.SYNCHRONIZE, stage.REFINE, stage.IDENTIFY, stage.HOLD, stage.EDIT),
    choices=(*CHOICES, "feet"),
    is_planned=_is_edited,
    is_of_edits=True,
    pieces_of=stage.REFIT,
)
def refit(task: stage.Task, context: stage.Context) -> stage.Output:
    """Animate and correct a part of the people changed by edits, unless an earlier task has done so."""
    from pipeline.core.data.animation import Animation
    from pipeline.core.progress import split
    from pipeline.core.runtime.record_archive import encode
    from pipeline.run.engine.refitting import Refitter
    from pipeline.run.engine.stored_people import found_people

    changed, on_share = found_people(context, stage.EDIT).people, context.on_share(task)
    refitter = Refitter(task, context)
    numbers = range(len(changed.tracks))[refit.people(task)]
    fitted = [
        refitter.animation(changed.tracks[number], changed.observations[number], on_person)
        for number, on_person in zip(numbers, split(on_share, [1] * len(numbers)), strict=True)
    ]
    on_share(1.0)
    tracks, motions = (person.tracks[0] for person in fitted), (person.motions[0] for person in fitted)
    animation = Animation(tuple(tracks), tuple(motions), refitter.floor)
    return stage.Output(encode(animation), pieces=refitter.pieces.files)
