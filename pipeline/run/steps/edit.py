"""Edit people: those whom edits change, put together from those who were found. The output is stored people."""

from pipeline.core.options.config import ReconstructionConfig
from pipeline.run.engine.stage import EDIT, IDENTIFY, SYNCHRONIZE, Context, Output, SessionFacts, Stage, Task


def edit(task: Task, context: Context) -> Output:
    """Put the people together whom the edits change."""
    from pipeline.run.engine.editing import changed_people, edited_take
    from pipeline.run.engine.people import write_people

    identified = context.people(IDENTIFY)
    take = edited_take(identified.spans, context.config, context.wanted(context.outline()).timebase)
    path = context.scratch / "people.npz"
    write_people(path, changed_people(identified.people, identified.spans, take))
    context.on_share(task)(1.0)
    return Output(path.read_bytes())


def is_edited(_: SessionFacts, config: ReconstructionConfig) -> bool:
    """Whether a job has edits that say who is where; names change nobody's frames."""
    return config.is_of_people and bool(config.people_edits)


STAGE = Stage(
    EDIT,
    "Edit people",
    edit,
    cut="whole",
    follows=(SYNCHRONIZE, IDENTIFY),
    choices=("edits",),
    is_planned=is_edited,
    is_of_edits=True,
)
