"""Find the board: its corners in frames of a camera. The output is a ``BoardViews``."""

from pipeline.core.errors import PipelineError
from pipeline.core.options.job_choices import BOARD_FRAMES, CalibrationChoices
from pipeline.run.engine.stage import FIND_BOARD, Context, Output, Stage, Task


def find_board(task: Task, context: Context) -> Output:
    """Look for the board in frames of a camera."""
    import numpy as np

    from pipeline.calibration.board.source import frames_to_look_at, look_in_video, photographs_to_look_at
    from pipeline.calibration.board.spec import parse_board
    from pipeline.run.engine.codec import encode

    session, making, camera = context.videos(), context.config.making, task.one_camera
    if not isinstance(making, CalibrationChoices) or making.board is None:
        raise PipelineError("The job looks for no board.")
    starts_s, ends_s = zip(*((times.time_s[0], times.time_s[-1]) for times in session.times.values()), strict=True)
    own_s = session.times[camera].time_s
    frames = frames_to_look_at(own_s, (float(min(starts_s)), float(max(ends_s))), 1.0 / session.timebase.frame_rate_hz)
    if making.has_photographs:
        frames, own_s = photographs_to_look_at(len(own_s)), np.full(len(own_s), np.nan)
    board = parse_board(making.board)
    with context.video(camera):
        views = look_in_video(session.video_of[camera], camera, own_s, frames, board, context.on_unit)
    return Output(encode(views))


STAGE = Stage(
    FIND_BOARD,
    "Find the board",
    find_board,
    cut="cameras",
    follows=(),
    choices=("making",),
    is_planned=lambda facts, config: isinstance(config.making, CalibrationChoices) and config.making.board is not None,
    unit="frames",
    reads_videos=True,
    max_frames=BOARD_FRAMES,
)
