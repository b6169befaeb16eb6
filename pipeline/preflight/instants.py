"""Check of a session of videos by the people at a few instants, in which alone they are detected."""

from collections.abc import Callable

from pipeline.capture.session import CaptureSession
from pipeline.config import ReconstructionConfig, networks_of
from pipeline.detect.entries import entry_of
from pipeline.detect.profiles.detection import BodyDetector, load_detector, load_own
from pipeline.detect.profiles.instants import detect_at
from pipeline.findings import SessionCheck
from pipeline.preflight.session import check_bodies, frames_at_instants


def check_at_instants(
    session: CaptureSession, config: ReconstructionConfig, on_frame: Callable[[], None] = lambda: None
) -> SessionCheck:
    """Check a session of videos.

    Parameters
    ----------
    config
        Its detector or profile finds the bodies.
    on_frame
        Called after each frame of a camera.

    Raises
    ------
    InputError, ChildError
        If a video can't be decoded.
    ModelError
        If the detector is not installed.
    """
    body = networks_of(config).body
    detector: BodyDetector = load_own(body) if entry_of(body).own is not None else load_detector(body)
    detections = detect_at(session, frames_at_instants(session, session.stretches), detector, on_frame)
    return check_bodies(session, detections, detector.joints, session.stretches)
