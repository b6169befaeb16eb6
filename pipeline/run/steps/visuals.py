"""Visuals of a take: overlay videos, the report and the Rerun file. Each output is the index of the files."""

from functools import partial

from pipeline.core.options.file_formats import file_ending
from pipeline.core.options.job_choices import OVERLAY_KIND, REPORT_KIND, RERUN_KIND
from pipeline.run.engine import stage
from pipeline.run.steps.blur import head_regions_in


@stage.declared(
    stage.OVERLAY,
    "Drawing overlay videos",
    cut="cameras",
    follows=(*stage.TAKE, stage.HEADS),
    choices=("overlay", "blur_faces", "frame_range", "names"),
    is_planned=lambda facts, config: config.is_of_people and config.overlay and facts.has_videos,
    unit="frames",
    is_reusable=False,
    reads_videos=True,
    makes_files=True,
)
def draw_overlay(task: stage.Task, context: stage.Context) -> stage.Output:
    """Make the overlay video of a camera; none if it took no frame of the take."""
    from pipeline.export.overlay import draw_video, overlay_names
    from pipeline.run.engine.take import assemble
    from pipeline.run.engine.wanted_frames import captured_videos, wanted_on_clocks

    camera = task.one_camera
    with context.video(camera):
        session, take = wanted_on_clocks(context, captured_videos(context)), assemble(context)
        names = [shown.name for shown in take.cameras]
        path = context.scratch / overlay_names(names)[names.index(camera)]
        if not draw_video(session, take, camera, path, context.on_unit, head_regions_in(context, camera)):
            return stage.indexed(())
    return stage.indexed([stage.ResultFile(path.name, OVERLAY_KIND, None, "video/mp4", path)])


@stage.declared(
    stage.REPORT,
    "Writing the report",
    cut="whole",
    follows=(*stage.TAKE, stage.HEADS),
    choices=("report", "blur_faces", "names"),
    is_planned=lambda facts, config: config.is_of_people and config.report,
    is_reusable=False,
    makes_files=True,
)
def write_report(task: stage.Task, context: stage.Context) -> stage.Output:
    """Write the report: contents from the reconstruction and its session, pictures from the videos."""
    from pipeline.export.report.contents import gather_contents, list_versions
    from pipeline.export.report.page import encode_page
    from pipeline.run.engine.code import LIBRARIES
    from pipeline.run.engine.detection_source import detection_source
    from pipeline.run.engine.take import assemble
    from pipeline.run.engine.wanted_frames import wanted_on_clocks

    session, origin = wanted_on_clocks(context, context.outline()), context.files.origin()
    contents = gather_contents(
        session,
        assemble(context),
        context.config,
        list_versions(LIBRARIES, detection_source(context).networks),
        origin.name,
        origin.files,
        context.video,
        partial(head_regions_in, context),
        context.on_share(task),
    )
    path = context.scratch / "report.html"
    path.write_bytes(encode_page(contents))
    return stage.indexed([stage.ResultFile(path.name, REPORT_KIND, None, "text/html; charset=utf-8", path)])


@stage.declared(
    stage.RECORD,
    "Writing the Rerun file",
    cut="whole",
    follows=(stage.DETECT, *stage.TAKE, stage.HEADS),
    choices=("exports", "blur_faces", "names"),
    is_planned=lambda facts, config: config.is_of_people and "rerun" in config.exports,
    is_reusable=False,
    reads_videos=True,
    makes_files=True,
)
def write_rerun(task: stage.Task, context: stage.Context) -> stage.Output:
    """Write the Rerun file: the take, with the pictures and the detections of its session."""
    from pipeline.export.rerun.rerun_file import RecordedFootage
    from pipeline.export.rerun.rerun_file import write_rerun as write
    from pipeline.run.engine.detection_source import detection_source
    from pipeline.run.engine.take import assemble
    from pipeline.run.engine.wanted_frames import wanted_frames

    session, source = wanted_frames(context, context.session()), detection_source(context)
    detections = {} if source.finds_fields else source.bodies(session)
    path = context.scratch / f"take.{file_ending('rerun')}"
    write(
        assemble(context),
        path,
        RecordedFootage(session, detections, context.video, partial(head_regions_in, context)),
        context.on_share(task),
    )
    return stage.indexed([stage.ResultFile(path.name, RERUN_KIND, None, "application/octet-stream", path)])
