"""Clocks of a session's cameras, measured at the command line."""

from collections.abc import Mapping
from contextlib import nullcontext

from pipeline.capture.keypoints import KeypointSession
from pipeline.capture.session import Session
from pipeline.config import ReconstructionConfig
from pipeline.data.cameras import Synchronization
from pipeline.data.detections import Detections
from pipeline.detect.profiles.detection import detection_joints
from pipeline.joints import JointSet
from pipeline.progress import OnProgress, Progress
from pipeline.stages.local import detect_people
from pipeline.stages.stage import SYNCHRONIZE
from pipeline.synchronization.motions import excerpt
from pipeline.synchronization.session import listen
from pipeline.synchronization.sound.combined import synchronize_with_sound
from pipeline.synchronization.sound.offsets import SoundOffsets

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
