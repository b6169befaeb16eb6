"""Write the Rerun recording of a take. The output is the index of its file."""

from pipeline.core.options.config import ending_of
from pipeline.core.options.job_choices import RECORDING_KIND
from pipeline.run.engine.stage import DETECT, HEADS, RECORD, TAKE, Context, Output, ResultFile, Stage, Task, indexed


def write_recording(task: Task, context: Context) -> Output:
    """Write the recording: the take, with the pictures and the detections of its session."""
    from pipeline.export.recording.rerun_file import RecordedFootage
    from pipeline.export.recording.rerun_file import write_recording as write
    from pipeline.run.engine.take import assemble

    session, source = context.wanted(context.session()), context.detections
    detections = {} if source.finds_fields else source.bodies(session)
    path = context.scratch / f"take.{ending_of('rerun')}"
    write(
        assemble(context),
        path,
        RecordedFootage(session, detections, context.video, context.heads),
        context.on_share(task),
    )
    return indexed([ResultFile(path.name, RECORDING_KIND, None, "application/octet-stream", path)])


STAGE = Stage(
    RECORD,
    "Write the Rerun recording",
    write_recording,
    cut="whole",
    follows=(DETECT, *TAKE, HEADS),
    choices=("exports", "blur_faces", "names"),
    is_planned=lambda facts, config: config.is_of_people and "rerun" in config.exports,
    is_reusable=False,
    reads_videos=True,
    makes_files=True,
)
