"""Detection in one range of a camera's frames, and concatenation of such ranges."""

from collections.abc import Callable, Collection, Generator, Sequence
from contextlib import closing
from dataclasses import replace

import numpy as np
from jaxtyping import Int, UInt8

from pipeline.capture.session import CaptureSession
from pipeline.core.data.arrays import read_only
from pipeline.core.data.detections import Detections, MapGrid, PafFields
from pipeline.core.errors import InputError
from pipeline.core.joints import JointSet
from pipeline.core.runtime.resources import give_pictures_back
from pipeline.detection.appearance import NUM_BINS, PARTS, colour_histograms
from pipeline.detection.between import bodies_between, schedule_detections
from pipeline.detection.bodies import ImageBodies, join_colours, stack_bodies
from pipeline.detection.damage import ChangeMeter
from pipeline.detection.decoders.fields import ImageFields
from pipeline.detection.decoders.openpose import LIMBS
from pipeline.detection.detector import Detector
from pipeline.detection.profiles.profile_detector import BodyDetector
from pipeline.video.decode import decode
from pipeline.video.timeline import frames_in


def detect_chunk(
    session: CaptureSession,
    camera: str,
    span_s: tuple[float, float],
    detector: BodyDetector,
    on_frame: Callable[[], None] = lambda: None,
    measures_colours: bool = False,
    follow_s: float = 0.0,
) -> Detections:
    """Decode a camera's frames with times in ``[t0, t1)``, and detect bodies in them.

    - ``span_s``: t0 and t1 on the session's clock.
    - ``measures_colours``: whether the colours of the bodies are measured; see ``appearance``.
    - ``follow_s``: longest time between two detections, see ``between``. 0: every frame is detected.
    - Returns detections; frames are numbered from the start of the video.
    - Raises ``InputError, ChildError``: see ``decode``.
    """
    damaged: list[int] = []
    meter = ChangeMeter()
    bodies: list[tuple[int, ImageBodies]] = []
    colours: list[UInt8[np.ndarray, "n parts bins"]] = []
    with closing(_detected(session, camera, span_s, detector, follow_s, damaged.append)) as frames:
        for frame, image_rgb, image_bodies in frames:
            meter.add(frame, image_rgb)
            bodies.append((frame, image_bodies))
            if measures_colours:
                colours.append(
                    colour_histograms(image_rgb, image_bodies.keypoints_px, image_bodies.score, detector.joints)
                )
            on_frame()
    detections = stack_bodies(camera, bodies, len(detector.joints.names))
    return replace(detections, damaged=_frame_numbers(damaged), colour=join_colours(colours), changes=meter.changes())


def _detected(
    session: CaptureSession,
    camera: str,
    span_s: tuple[float, float],
    detector: BodyDetector,
    follow_s: float,
    on_damaged: Callable[[int], None],
) -> Generator[tuple[int, UInt8[np.ndarray, "height width 3"], ImageBodies], None, None]:
    """Number, picture and bodies of each frame of a range; see ``detect_chunk``."""
    time_s = session.times[camera].time_s
    frames = frames_in(session.times[camera], *span_s)
    if not len(frames):
        return

    def on_own_damaged(frame: int) -> None:
        if frame in frames:
            on_damaged(frame)

    schedule = schedule_detections(time_s, frames, follow_s)
    with closing(camera_images(session, camera, schedule.frames, on_damaged=on_own_damaged)) as images:
        for frame, image_rgb, bodies in bodies_between(images, detector, schedule):
            if frame in frames:
                yield frame, image_rgb, bodies


def measure_colours(
    session: CaptureSession,
    span_s: tuple[float, float],
    detections: Detections,
    joints: JointSet,
    on_frame: Callable[[], None] = lambda: None,
) -> Detections:
    """Decode a range of frames once more, and measure the colours of the bodies that were detected in them.

    ``detections`` come from ``detect_chunk`` in the same range. They get the colours that it would have measured,
    zeros in frames that are missing now.
    """
    colour = np.zeros((len(detections.frame), len(PARTS), NUM_BINS), np.uint8)
    with closing(_images(session, detections.camera, span_s, on_frame, lambda _: None)) as frames:
        for frame, image_rgb in frames:
            rows = slice(*np.searchsorted(detections.frame, [frame, frame + 1]))
            bodies = detections.keypoints_px[rows], detections.score[rows]
            colour[rows] = colour_histograms(image_rgb, *bodies, joints)
    return replace(detections, colour=read_only(colour))


def detect_fields_chunk(
    session: CaptureSession,
    camera: str,
    span_s: tuple[float, float],
    detector: Detector,
    on_frame: Callable[[], None] = lambda: None,
) -> PafFields:
    """Detect peaks and part affinity fields in a range of frames; see ``detect_chunk``.

    The detector's network must have part affinity fields.
    """
    damaged: list[int] = []
    meter = ChangeMeter()
    fields: list[tuple[int, ImageFields]] = []
    with closing(_images(session, camera, span_s, on_frame, damaged.append)) as frames:
        for frame, image_rgb in frames:
            meter.add(frame, image_rgb)
            fields.append((frame, detector.detect_fields(image_rgb)))
    return replace(stack_fields(camera, fields), damaged=_frame_numbers(damaged), changes=meter.changes())


def _images(
    session: CaptureSession,
    camera: str,
    span_s: tuple[float, float],
    on_frame: Callable[[], None],
    on_damaged: Callable[[int], None],
) -> Generator[tuple[int, UInt8[np.ndarray, "height width 3"]], None, None]:
    """Decode a range of frames with their numbers; ``on_frame`` is called when the next frame is requested."""
    frames = frames_in(session.times[camera], *span_s)
    return camera_images(session, camera, frames, on_frame, on_damaged)


def camera_images(
    session: CaptureSession,
    camera: str,
    frames: range,
    on_frame: Callable[[], None] = lambda: None,
    on_damaged: Callable[[int], object] = lambda _: None,
    only: Collection[int] | None = None,
) -> Generator[tuple[int, UInt8[np.ndarray, "height width 3"]], None, None]:
    """Decode frames of a camera with their numbers.

    ``frames``, ``on_damaged`` and ``only`` are the same as for ``decode``, and so are the errors; problems name the
    camera. ``on_frame`` is called when the frame after each frame is requested.
    """
    give_pictures_back()
    video = session.videos[[known.name for known in session.cameras].index(camera)]
    try:
        with closing(decode(video, frames.start, frames.stop, on_damaged, only)) as images:
            for frame, image_rgb in images:
                yield frame, image_rgb
                on_frame()
    except InputError as error:
        raise InputError([replace(problem, camera=camera) for problem in error.problems]) from error


def _frame_numbers(frames: Sequence[int]) -> Int[np.ndarray, " frames"]:
    return read_only(np.array(frames, np.int64))


def stack_fields(camera: str, numbered: Sequence[tuple[int, ImageFields]]) -> PafFields:
    """Stack the fields of a camera's images.

    ``numbered`` has frame number and fields of each image, by frame number; all have the same shape and grid.
    """
    num_limbs = len(LIMBS)
    images = [image for _, image in numbered]
    return PafFields(
        camera=camera,
        frame=read_only(np.array([frame for frame, _ in numbered], np.int64)),
        peak_row=read_only(np.repeat(np.arange(len(images)), [len(image.joint) for image in images])),
        peak_joint=read_only(np.concatenate([np.empty(0, np.int64), *(image.joint for image in images)])),
        peak_px=read_only(np.concatenate([np.empty((0, 2)), *(image.points_px for image in images)])),
        peak_score=read_only(np.concatenate([np.empty(0), *(image.score for image in images)])),
        fields=read_only(
            np.stack([image.fields for image in images]) if images else np.empty((0, num_limbs, 2, 1, 1), np.uint8)
        ),
        limbs=LIMBS,
        grid=images[0].grid if images else MapGrid((0.0, 0.0), (1.0, 1.0)),
    )
