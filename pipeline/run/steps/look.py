"""Look at people: how each camera hangs and the size of its images, by the people in a few of its frames.

The output is a ``CameraLook``. It belongs to the whole video, whatever part of it is wanted.
"""

from functools import partial

from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.options.job_choices import CalibrationChoices
from pipeline.run.engine.stage import LOOK, Context, Output, SessionFacts, Stage, Task

LOOKED_AT_FRAMES = 12
"""Largest number of frames of a camera that are looked at."""
# Fewer are enough for networks that are not sized, of which a pass takes longer.
_UNSIZED_FRAMES = 3


def look(task: Task, context: Context) -> Output:
    """Look at the people in some frames of a camera's whole video: turn and size of its images."""
    from pipeline.detection.look import look_at_people
    from pipeline.detection.profiles.detection import open_finder, shows_lean
    from pipeline.detection.profiles.sizes import RULES
    from pipeline.detection.upright import turn_of_roll
    from pipeline.run.engine.codec import encode

    session, config, name = context.videos(), context.config, task.one_camera
    networks = config.networks
    rule = RULES[config.profile] if networks.is_sized else None
    camera = next(camera for camera in session.cameras if camera.name == name)
    # A camera that is to be calibrated has no pose.
    known_deg = turn_of_roll(camera) if config.is_of_people else None
    look = partial(
        look_at_people,
        open_turned=partial(open_finder, networks),
        rule=rule,
        known_deg=known_deg,
        max_frames=LOOKED_AT_FRAMES if networks.is_sized else _UNSIZED_FRAMES,
        shows_lean=shows_lean(networks),
        on_frame=context.on_unit,
    )
    with context.video(name):
        return Output(encode(look(session, name)))


def is_detecting(facts: SessionFacts, config: ReconstructionConfig) -> bool:
    """Whether a job has people detected in videos: to reconstruct them, or to calibrate by them."""
    making = config.making
    is_wanted = config.is_of_people or (isinstance(making, CalibrationChoices) and making.board is None)
    return facts.has_videos and is_wanted


STAGE = Stage(
    LOOK,
    "Look at people",
    look,
    cut="cameras",
    follows=(),
    choices=("profile", "detector", "poses"),
    is_planned=is_detecting,
    unit="frames",
    reads_videos=True,
    runs_networks=True,
    max_frames=LOOKED_AT_FRAMES,
)
