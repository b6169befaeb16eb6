"""Look at people: the size of each camera's images, chosen by the people in a few of its frames.

The output is a ``CameraSizes``. It belongs to the whole video, whatever part of it is wanted.
"""

from pipeline.config import ReconstructionConfig, networks_of
from pipeline.job_choices import CalibrationChoices
from pipeline.stages.stage import LOOK, Context, Output, SessionFacts, Stage, Task

LOOKED_AT_FRAMES = 12
"""Largest number of frames of a camera that are decoded."""


def look(task: Task, context: Context) -> Output:
    """Look at the people in some frames of a camera's whole video, and choose the size of its images."""
    from pipeline.detect.look import look_at_people
    from pipeline.detect.profiles.detection import load_detector
    from pipeline.detect.profiles.sizes import RULES
    from pipeline.stages.codec import encode

    session = context.videos()
    detector = load_detector(networks_of(context.config).body)
    rule = RULES[context.config.profile]
    with context.video(task.one_camera):
        sizes = look_at_people(session, task.one_camera, detector, rule, LOOKED_AT_FRAMES, context.on_unit)
    return Output(encode(sizes))


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
    choices=("profile", "detector"),
    is_planned=lambda facts, config: is_detecting(facts, config) and networks_of(config).is_sized,
    unit="frames",
    max_frames=LOOKED_AT_FRAMES,
)
