"""Convert videos for browsers: small copies that they play. The output is empty."""

from pipeline.core.options.job_choices import PROXY_KIND, ProxyChoices, proxy_name
from pipeline.run.engine.stage import PROXY, Context, Output, ResultFile, Task, declared


@declared(
    PROXY,
    "Converting videos for browsers",
    cut="cameras",
    follows=(),
    choices=("making",),
    is_planned=lambda facts, config: isinstance(config.making, ProxyChoices),
    unit="frames",
    is_reusable=False,
    reads_videos=True,
)
def make_proxy(task: Task, context: Context) -> Output:
    """Make a small copy of a camera's video."""
    from pipeline.run.engine.wanted_frames import captured_videos
    from pipeline.video.playback.proxy import make_proxy_in_child

    session, camera = captured_videos(context), task.one_camera
    path = context.scratch / proxy_name(list(session.camera_videos).index(camera))
    with context.video(camera):
        make_proxy_in_child(session.camera_videos[camera], session.times[camera].time_s, path, context.on_unit)
    return Output(b"", (ResultFile(path.name, PROXY_KIND, None, "video/mp4", path),))
