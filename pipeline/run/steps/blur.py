"""Blur videos: a small copy of each camera's video for browsers, with blurred heads. The output is the files' index.

Edits of people change no head, so the copies of a job are made once.
"""

from pipeline.core.options.job_choices import BLURRED_KIND, blurred_name
from pipeline.run.engine.stage import BLUR, HEADS, SYNCHRONIZE, Context, Output, ResultFile, Stage, Task, indexed
from pipeline.run.steps.heads import blurs_heads


def blur_videos(task: Task, context: Context) -> Output:
    """Make the blurred video of a camera."""
    from pipeline.core.errors import PipelineError
    from pipeline.export.blurred_video import write_blurred
    from pipeline.video.timeline import frames_in

    camera, heads = task.one_camera, context.heads(task.one_camera)
    if heads is None:
        raise PipelineError("Heads are not to be blurred in the pictures of this job.")
    session, take = context.videos(), context.on_clocks(context.outline())
    timebase = take.timebase
    frames = frames_in(take.times[camera], timebase.time_s(-0.5), timebase.time_s(timebase.num_frames - 0.5))
    path = context.scratch / blurred_name(list(session.video_of).index(camera))
    with context.video(camera):
        write_blurred(session.video_of[camera], session.times[camera].time_s, frames, heads, path, context.on_unit)
    return indexed([ResultFile(path.name, BLURRED_KIND, None, "video/mp4", path)])


STAGE = Stage(
    BLUR,
    "Blur videos",
    blur_videos,
    cut="cameras",
    follows=(SYNCHRONIZE, HEADS),
    choices=("blurs_videos", "frame_range"),
    is_planned=lambda facts, config: config.blurs_videos and blurs_heads(facts, config),
    unit="frames",
    is_reusable=False,
    reads_videos=True,
    makes_files=True,
)
