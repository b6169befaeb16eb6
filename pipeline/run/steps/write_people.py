"""Write files of edited people: pieces that the stage ``export`` finds again. The output is empty."""

from pipeline.run.engine.stage import EXPORT, TAKE, WRITE, Context, Output, Stage, Task


def write_people(task: Task, context: Context) -> Output:
    """Write the files of a part of the people."""
    from pipeline.export.results import keep_people
    from pipeline.run.engine.pieces import FilesInPieces, Pieces
    from pipeline.run.engine.take import assemble

    config, pieces = context.config, Pieces(task, context)
    choices = config.exports, config.bvh, config.output_rate_hz, config.timeline, config.body
    files = FilesInPieces(pieces, context.scratch)
    keep_people(assemble(context), STAGE.people(task), context.scratch, *choices, context.on_share(task), files)
    return Output(b"", pieces=pieces.files)


STAGE = Stage(
    WRITE,
    "Write files of edited people",
    write_people,
    cut="people",
    follows=TAKE,
    choices=("exports", "bvh", "output_rate_hz", "timeline", "body"),
    is_planned=lambda facts, config: config.making is None and bool(config.people_edits),
    is_of_edits=True,
    pieces_of=EXPORT,
)
