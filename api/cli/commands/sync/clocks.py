"""Clocks of a session's cameras, measured at the command line."""

from collections.abc import Mapping
from contextlib import nullcontext

from pipeline.capture.keypoints import KeypointSession
from pipeline.capture.session import Session
from pipeline.capture.synchronization.motions import excerpt
from pipeline.capture.synchronization.session import listen
from pipeline.capture.synchronization.sound.combined import synchronize_with_sound
from pipeline.capture.synchronization.sound.offsets import SoundOffsets
from pipeline.core.data.cameras import Synchronization
from pipeline.core.data.detections import Detections
from pipeline.core.joints import JointSet
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.progress import OnProgress, Progress
from pipeline.detection.profiles.detection import detection_joints
from pipeline.run.engine.local import detect_people
from pipeline.run.engine.stage import SYNCHRONIZE

_PERCENT = 100


def all_bodies(
    session: Session, config: ReconstructionConfig, on_progress: OnProgress
) -> tuple[Mapping[str, Detections], JointSet]:
    """Bodies in all frames of a session by camera, and their joints; those in videos are detected."""
    if isinstance(session, KeypointSession):
        return session.detections, session.joints
    return detect_people(session, config, on_progress), detection_joints(config)


def measured_clocks(
    session: Session, detections: Mapping[str, Detections], joints: JointSet, on_progress: OnProgress
) -> tuple[Synchronization, SoundOffsets]:
    """Clocks from the motion of the bodies and the sound of the videos, and what the sound alone told."""
    sound = listen(session, lambda camera: nullcontext())
    found = synchronize_with_sound(
        session.cameras,
        session.times,
        excerpt(session.times, detections),
        joints,
        session.starts_s,
        sound,
        lambda share: on_progress(Progress(SYNCHRONIZE, round(_PERCENT * share), _PERCENT)),
    )
    return found, sound
