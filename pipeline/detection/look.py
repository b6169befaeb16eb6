"""First look at a camera's people: bodies in some frames of the whole video, which tell how to show it to a network."""

from collections.abc import Callable, Sequence
from contextlib import closing

import numpy as np

from pipeline.capture.session import CaptureSession
from pipeline.core.data.turns import upright_size_px
from pipeline.detection.bodies import BodyDetector, ImageBodies
from pipeline.detection.chunk import camera_images
from pipeline.detection.profiles.sizes import CameraLook, SizeRule, body_spans_px, choose_sizes
from pipeline.detection.upright import find_turn
from pipeline.video.info import VideoInfo

# With fewer keyframes, other frames are looked at too, and all frames before them have to be decoded.
_MIN_KEYFRAMES = 4
# Limit on the frames that are decoded if there are few keyframes.
_MAX_DECODED = 3000


def look_at_people(
    session: CaptureSession,
    camera: str,
    open_turned: Callable[[float], BodyDetector],
    rule: SizeRule | None,
    known_deg: float | None,
    max_frames: int,
    shows_lean: bool,
    on_frame: Callable[[], None] = lambda: None,
) -> CameraLook:
    """Look at the people in some of a camera's frames: how they hang in the picture, and how large they are.

    The look depends on the whole video, the calibration and the rule alone. Raises as ``pipeline.video.decode.decode``.

    - ``open_turned``: opens the detector, at its usual size, for images that a counterclockwise turn in degrees brings
      upright.
    - ``rule``: rule that chooses the size of the images; ``None``: they have the usual size, and a camera that is known
      to be upright is not looked at.
    - ``known_deg``: turn by the calibration, see ``pipeline.detection.upright.turn_of_roll``; ``None`` if it is not
      known.
    - ``max_frames``: largest number of frames.
    - ``shows_lean``: see ``pipeline.detection.upright.find_turn``.
    - ``on_frame``: called for each frame of the first look.
    """
    if rule is None and known_deg == 0.0:
        return CameraLook()
    video = session.videos[[known.name for known in session.cameras].index(camera)]
    chosen = frames_to_look_at(video, max_frames)

    def look_at(turn_deg: float) -> list[tuple[int, ImageBodies]]:
        detector, counted = open_turned(turn_deg), on_frame if turn_deg == (known_deg or 0.0) else lambda: None
        with closing(camera_images(session, camera, range(video.num_frames), counted, only=chosen)) as images:
            return [(frame, detector.detect(image_rgb)) for frame, image_rgb in images]

    turn_deg, bodies = find_turn(known_deg, open_turned(0.0).joints, look_at, shows_lean)
    if rule is None:
        return CameraLook(turn_deg=turn_deg)
    spans_px = [body_spans_px(image, turn_deg) for _, image in bodies]
    return CameraLook(choose_sizes(spans_px, upright_size_px(video.size_px, turn_deg), rule), turn_deg)


def frames_to_look_at(video: VideoInfo, max_frames: int) -> Sequence[int]:
    """Numbers of the frames to look at, ascending: keyframes if there are some, else frames of the first minutes."""
    keyframes = np.flatnonzero(np.isin(video.pts, video.keyframe_pts))
    candidates = keyframes if len(keyframes) >= _MIN_KEYFRAMES else np.arange(min(video.num_frames, _MAX_DECODED))
    number = min(max_frames, len(candidates))
    # In the middle of equal parts.
    places = (np.arange(number) + 0.5) * len(candidates) / number
    frames: list[int] = candidates[places.astype(np.int64)].tolist()
    return frames
