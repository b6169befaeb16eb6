"""Draw overlay videos: each camera's video with the skeletons drawn over it. The output is the index of the files."""

from pipeline.core.options.job_choices import OVERLAY_KIND
from pipeline.run.engine.stage import HEADS, OVERLAY, TAKE, Context, Output, ResultFile, Stage, Task, indexed


def draw_overlay(task: Task, context: Context) -> Output:
    """Make the overlay video of a camera; none if it took no frame of the take."""
    from pipeline.export.overlay_video import draw_video, overlay_names
    from pipeline.run.engine.take import assemble

    camera = task.one_camera
    with context.video(camera):
        session, take = context.on_clocks(context.videos()), assemble(context)
        names = [shown.name for shown in take.cameras]
        path = context.scratch / overlay_names(names)[names.index(camera)]
        if not draw_video(session, take, camera, path, context.on_unit, context.heads(camera)):
            return indexed(())
    return indexed([ResultFile(path.name, OVERLAY_KIND, None, "video/mp4", path)])


STAGE = Stage(
    OVERLAY,
    "Draw overlay videos",
    draw_overlay,
    cut="cameras",
    follows=(*TAKE, HEADS),
    choices=("overlay", "blur_faces", "frame_range", "names"),
    is_planned=lambda facts, config: config.is_of_people and config.overlay and facts.has_videos,
    unit="frames",
    is_reusable=False,
    reads_videos=True,
    makes_files=True,
)
