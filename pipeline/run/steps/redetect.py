"""Detect leaning bodies again, where they are expected in a range of a camera's frames.

The output is a ``Detections``.
"""

from functools import partial

from pipeline.core.options.config import ReconstructionConfig
from pipeline.run.engine.stage import EXPECT, LOOK, REDETECT, SYNCHRONIZE, Context, Output, SessionFacts, Stage, Task


def redetect(task: Task, context: Context) -> Output:
    """Read the joints of expected bodies in crops; nothing is loaded or decoded where nobody is expected."""
    return read_expected(task, context, EXPECT)


def read_expected(task: Task, context: Context, stage: str) -> Output:
    """Read the joints of the bodies that a stage expects in a range of a camera's frames."""
    from pipeline.association.redetection.crops import detect_expected
    from pipeline.core.data.detections import Detections
    from pipeline.core.joints import without_hands
    from pipeline.detection.profiles.detection import load_landmarks
    from pipeline.run.engine.codec import decode, encode
    from pipeline.run.engine.detections import detection_source
    from pipeline.run.engine.wanted_frames import captured_videos
    from pipeline.video.timeline import frames_in, span_s

    session, camera, networks = captured_videos(context), task.one_camera, context.config.networks
    if networks.again is None:
        raise ValueError("These networks look for nobody again: the stage is not planned.")
    detections = detection_source(context)
    (expected,) = context.outputs(stage)
    number = list(context.facts.camera_rates_hz).index(camera)
    span = span_s(session.timebase, task.frames.start, task.frames.stop)
    bodies = decode(tuple[Detections, ...], expected)[number].within(frames_in(session.times[camera], *span))
    on_share = context.on_share(task)
    with context.video(camera):
        found = detect_expected(
            session,
            bodies,
            partial(load_landmarks, networks.again),
            without_hands(detections.joints(session)),
            networks.refines_body,
            detections.turns_deg[camera],
            on_share,
        )
    on_share(1.0)
    return Output(encode(found))


def is_redetecting(facts: SessionFacts, config: ReconstructionConfig) -> bool:
    """Return whether leaning bodies are detected again: with the networks of the profiles, which mark joints alike."""
    return facts.has_videos and config.is_of_people and config.networks.again is not None


STAGE = Stage(
    REDETECT,
    "Detect leaning bodies again",
    redetect,
    cut="camera ranges",
    follows=(LOOK, SYNCHRONIZE, EXPECT),
    choices=("profile", "joints", "detector", "output"),
    is_planned=is_redetecting,
    frames_a_unit=10,
    reads_videos=True,
    runs_networks=True,
)
