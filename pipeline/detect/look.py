"""First look at a camera's people: bodies in some frames of the whole video, which choose the size of its images."""

from collections.abc import Callable, Sequence
from contextlib import closing

import numpy as np

from pipeline.capture.session import CaptureSession
from pipeline.detect.chunk import camera_images
from pipeline.detect.profiles.detection import BodyDetector
from pipeline.detect.profiles.sizes import CameraSizes, SizeRule, body_spans_px, choose_sizes
from pipeline.video.info import VideoInfo

# With fewer keyframes, other frames are looked at too, and all frames before them have to be decoded.
_MIN_KEYFRAMES = 4
# Limit on the frames that are decoded if there are few keyframes.
_MAX_DECODED = 3000


def look_at_people(
    session: CaptureSession,
    camera: str,
    detector: BodyDetector,
    rule: SizeRule,
    max_frames: int,
    on_frame: Callable[[], None] = lambda: None,
) -> CameraSizes:
    """Choose the size of a camera's images by the people in some of its frames.

    The detector is at its usual size. The sizes depend on the whole video and the rule alone. Raises as
    ``pipeline.video.decode.decode``.
    """
    video = session.videos[[known.name for known in session.cameras].index(camera)]
    chosen = frames_to_look_at(video, max_frames)
    with closing(camera_images(session, camera, range(video.num_frames), on_frame, only=chosen)) as images:
        spans_px = [body_spans_px(detector.detect(image_rgb)) for _, image_rgb in images]
    return choose_sizes(spans_px, video.size_px, rule)


def frames_to_look_at(video: VideoInfo, max_frames: int) -> Sequence[int]:
    """Numbers of the frames to look at, ascending: keyframes if there are some, else frames of the first minutes."""
    keyframes = np.flatnonzero(np.isin(video.pts, video.keyframe_pts))
    candidates = keyframes if len(keyframes) >= _MIN_KEYFRAMES else np.arange(min(video.num_frames, _MAX_DECODED))
    number = min(max_frames, len(candidates))
    # In the middle of equal parts.
    places = (np.arange(number) + 0.5) * len(candidates) / number
    frames: list[int] = candidates[places.astype(np.int64)].tolist()
    return frames
