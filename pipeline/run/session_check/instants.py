"""Check of a session of videos by the people at a few instants, in which alone they are detected."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from functools import partial

from pipeline.capture.session import CaptureSession
from pipeline.core.data.cameras import Camera
from pipeline.core.data.detections import Detections
from pipeline.core.findings import SessionCheck
from pipeline.core.options.config import ReconstructionConfig
from pipeline.detection.bodies import BodyDetector, stack_bodies
from pipeline.detection.chunk import camera_images
from pipeline.detection.profiles.profile_detector import open_finder, shows_lean
from pipeline.detection.upright import NumberedBodies, find_turn, turn_of_roll
from pipeline.run.session_check.check_session import check_bodies, frames_at_instants, hanging_cameras

# Shorter videos are decoded once from start to end. In longer ones a decoder is started at each frame.
_DECODED_WHOLE = 600

OpenTurned = Callable[[float], BodyDetector]
"""Function that opens the detector of a camera whose pictures a counterclockwise turn in degrees brings upright."""


def check_at_instants(
    session: CaptureSession, config: ReconstructionConfig, on_frame: Callable[[], None] = lambda: None
) -> SessionCheck:
    """Check a session of videos.

    The detector or profile of ``config`` finds the bodies. Raises ``InputError`` or ``ChildError`` if a video can't be
    decoded, ``ModelError`` if the detector is not installed.
    """
    networks = config.networks
    open_turned = partial(open_finder, networks)
    frames = frames_at_instants(session.times, session.timebase, session.stretches)
    detections, turns_deg = detect_at(session, frames, open_turned, shows_lean(networks), on_frame)
    check = check_bodies(session, detections, open_turned(0.0).joints, session.stretches)
    return replace(check, findings=(*check.findings, *hanging_cameras(turns_deg)))


def detect_at(
    session: CaptureSession,
    frames: Mapping[str, Sequence[int | None]],
    open_turned: OpenTurned,
    is_lean_shown: bool,
    on_frame: Callable[[], None] = lambda: None,
) -> tuple[Mapping[str, Detections], Mapping[str, float]]:
    """Detect bodies in some frames of each camera, in pictures that are brought upright.

    Numbers of the frames are by camera; ``None`` is left out. ``is_lean_shown`` is ``shows_lean`` of ``find_turn``.
    ``on_frame`` is called for each frame once. Returns the detections and the turns by camera. Raises as
    ``pipeline.video.decode.decode``.
    """
    detections, turns_deg = {}, {}
    joints = open_turned(0.0).joints
    for camera in session.cameras:
        known_deg = turn_of_roll(camera)
        wanted = sorted({frame for frame in frames[camera.name] if frame is not None})
        look_at = partial(_detect, session, camera, wanted, open_turned, known_deg or 0.0, on_frame)
        turns_deg[camera.name], bodies = find_turn(known_deg, joints, look_at, is_lean_shown)
        detections[camera.name] = stack_bodies(camera.name, bodies, len(joints.names))
    return detections, turns_deg


def _detect(
    session: CaptureSession,
    camera: Camera,
    wanted: Sequence[int],
    open_turned: OpenTurned,
    counted_deg: float,
    on_frame: Callable[[], None],
    turn_deg: float,
) -> NumberedBodies:
    """Detect bodies in frames of a camera; only bodies of one turn are counted."""
    detector, count = open_turned(turn_deg), on_frame if turn_deg == counted_deg else lambda: None
    num_frames = session.camera_videos[camera.name].num_frames
    spans = [range(num_frames)] if num_frames <= _DECODED_WHOLE else [range(k, k + 1) for k in wanted]
    bodies = []
    for span in spans:
        only = [frame for frame in wanted if frame in span]
        with closing(camera_images(session, camera.name, span, count, only=only)) as images:
            bodies += [(frame, detector.detect(image_rgb)) for frame, image_rgb in images]
    return bodies
