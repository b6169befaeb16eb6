"""Check of a session of videos by the people at a few instants, in which alone they are detected."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing

from pipeline.capture.session import CaptureSession
from pipeline.config import ReconstructionConfig, networks_of
from pipeline.data.detections import Detections
from pipeline.detect.bodies import BodyDetector
from pipeline.detect.chunk import camera_images, stack_bodies
from pipeline.detect.entries import entry_of
from pipeline.detect.profiles.detection import load_detector, load_own
from pipeline.findings import SessionCheck
from pipeline.preflight.session import check_bodies, frames_at_instants

# Shorter videos are decoded once from start to end. In longer ones a decoder is started at each frame.
_DECODED_WHOLE = 600


def check_at_instants(
    session: CaptureSession, config: ReconstructionConfig, on_frame: Callable[[], None] = lambda: None
) -> SessionCheck:
    """Check a session of videos.

    The detector or profile of ``config`` finds the bodies. Raises ``InputError`` or ``ChildError`` if a video can't be
    decoded, ``ModelError`` if the detector is not installed.
    """
    body = networks_of(config).body
    detector: BodyDetector = load_own(body) if entry_of(body).own is not None else load_detector(body)
    detections = detect_at(session, frames_at_instants(session, session.stretches), detector, on_frame)
    return check_bodies(session, detections, detector.joints, session.stretches)


def detect_at(
    session: CaptureSession,
    frames: Mapping[str, Sequence[int | None]],
    detector: BodyDetector,
    on_frame: Callable[[], None] = lambda: None,
) -> Mapping[str, Detections]:
    """Detect bodies in some frames of each camera.

    Numbers of the frames are by camera; ``None`` is left out. Raises as ``pipeline.video.decode.decode``.
    """
    detections = {}
    for video, camera in zip(session.videos, session.cameras, strict=True):
        wanted = sorted({frame for frame in frames[camera.name] if frame is not None})
        spans = [range(video.num_frames)] if video.num_frames <= _DECODED_WHOLE else [range(k, k + 1) for k in wanted]
        bodies = []
        for span in spans:
            only = [frame for frame in wanted if frame in span]
            with closing(camera_images(session, camera.name, span, on_frame, only=only)) as images:
                bodies += [(frame, detector.detect(image_rgb)) for frame, image_rgb in images]
        detections[camera.name] = stack_bodies(camera.name, bodies, len(detector.joints.names))
    return detections
