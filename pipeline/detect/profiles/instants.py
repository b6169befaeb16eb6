"""Detection in a few frames of each camera, all over the session."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing

from pipeline.capture.session import CaptureSession
from pipeline.data.detections import Detections
from pipeline.detect.bodies import BodyDetector
from pipeline.detect.chunk import camera_images, stack_bodies

# Shorter videos are decoded once from start to end. In longer ones a decoder is started at each frame.
_DECODED_WHOLE = 600


def detect_at(
    session: CaptureSession,
    frames: Mapping[str, Sequence[int | None]],
    detector: BodyDetector,
    on_frame: Callable[[], None] = lambda: None,
) -> Mapping[str, Detections]:
    """Detect bodies in some frames of each camera.

    Parameters
    ----------
    frames
        Numbers of the frames by camera; ``None`` is left out.
    detector
        Detector of bodies.
    on_frame
        Called after each frame.

    Raises
    ------
    InputError, ChildError
        See ``pipeline.video.decode.decode``.
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
