"""Write the report of a take. The output is the index of its file."""

from pipeline.core.options.job_choices import REPORT_KIND
from pipeline.run.engine.stage import HEADS, REPORT, TAKE, Context, Output, ResultFile, Stage, Task, indexed


def write_report(task: Task, context: Context) -> Output:
    """Write the report: contents from the reconstruction and its session, pictures from the videos."""
    from pipeline.export.report.contents import gather_contents, list_versions
    from pipeline.export.report.page import encode_page
    from pipeline.run.engine.code import LIBRARIES
    from pipeline.run.engine.take import assemble

    session, origin = context.on_clocks(context.outline()), context.origin()
    contents = gather_contents(
        session,
        assemble(context),
        context.config,
        list_versions(LIBRARIES, context.detections.networks),
        origin.name,
        origin.files,
        context.video,
        context.heads,
        context.on_share(task),
    )
    path = context.scratch / "report.html"
    path.write_bytes(encode_page(contents))
    return indexed([ResultFile(path.name, REPORT_KIND, None, "text/html; charset=utf-8", path)])


STAGE = Stage(
    REPORT,
    "Write the report",
    write_report,
    cut="whole",
    follows=(*TAKE, HEADS),
    choices=("report", "blur_faces", "names"),
    is_planned=lambda facts, config: config.is_of_people and config.report,
    is_reusable=False,
    makes_files=True,
)
