"""Decode and detect one range of one camera's frames: the map of a reconstruction."""

from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import closing
from dataclasses import replace

import numpy as np
from jaxtyping import Int, UInt8

from pipeline.capture.session import CaptureSession
from pipeline.data import Detections, MapGrid, PafFields, no_frames, read_only
from pipeline.detect.decoders.fields import ImageFields
from pipeline.detect.decoders.openpose import LIMBS
from pipeline.detect.detector import Bodies, Detector
from pipeline.errors import InputError
from pipeline.runtime.memory import give_pictures_back
from pipeline.video.decode import decode
from pipeline.video.timeline import frames_in


def detect_chunk(
    session: CaptureSession,
    camera: str,
    span_s: tuple[float, float],
    detector: Detector,
    on_frame: Callable[[], None] = lambda: None,
) -> Detections:
    """Detect bodies in exactly those frames of a camera whose time is in ``[t0, t1)``.

    Parameters
    ----------
    span_s
        t0 and t1 on the session's clock.
    on_frame
        Called after each frame.

    Returns
    -------
        Detections; frames are numbered from the start of the video.

    Raises
    ------
    InputError, ChildError
        As of ``decode``.
    """
    damaged: list[int] = []
    with closing(_images(session, camera, span_s, on_frame, damaged.append)) as frames:
        bodies = [(frame, detector.detect(image_rgb)) for frame, image_rgb in frames]
    found = _as_detections(camera, bodies, len(detector.joints.names))
    return replace(found, damaged=_frame_numbers(damaged))


def detect_fields_chunk(
    session: CaptureSession,
    camera: str,
    span_s: tuple[float, float],
    detector: Detector,
    on_frame: Callable[[], None] = lambda: None,
) -> PafFields:
    """Find peaks and part affinity fields in the same frames as ``detect_chunk`` does; arguments and errors likewise.

    Parameters
    ----------
    detector
        Of a network with part affinity fields.
    """
    damaged: list[int] = []
    with closing(_images(session, camera, span_s, on_frame, damaged.append)) as frames:
        found = [(frame, detector.detect_fields(image_rgb)) for frame, image_rgb in frames]
    return replace(stack_fields(camera, found), damaged=_frame_numbers(damaged))


def _images(
    session: CaptureSession,
    camera: str,
    span_s: tuple[float, float],
    on_frame: Callable[[], None],
    on_damaged: Callable[[int], None],
) -> Generator[tuple[int, UInt8[np.ndarray, "height width 3"]], None, None]:
    """Frames of a range and their numbers; each counts as done when the next one is asked for."""
    give_pictures_back()
    video = session.videos[[one.name for one in session.cameras].index(camera)]
    frames = frames_in(session.times[camera], *span_s)
    try:
        with closing(decode(video, frames.start, frames.stop, on_damaged)) as images:
            for frame, image_rgb in images:
                yield frame, image_rgb
                on_frame()
    except InputError as error:
        raise InputError([replace(problem, camera=camera) for problem in error.problems]) from error


def _frame_numbers(frames: Sequence[int]) -> Int[np.ndarray, " frames"]:
    return read_only(np.array(frames, np.int64))


def stack_fields(camera: str, found: Sequence[tuple[int, ImageFields]]) -> PafFields:
    """Join what was found in a camera's frames, whose fields lie alike."""
    num_limbs = len(LIMBS)
    images = [one for _, one in found]
    return PafFields(
        camera=camera,
        frame=read_only(np.array([frame for frame, _ in found], np.int64)),
        peak_row=read_only(np.repeat(np.arange(len(images)), [len(one.joint) for one in images])),
        peak_joint=read_only(np.concatenate([np.empty(0, np.int64), *(one.joint for one in images)])),
        peak_px=read_only(np.concatenate([np.empty((0, 2)), *(one.points_px for one in images)])),
        peak_score=read_only(np.concatenate([np.empty(0), *(one.score for one in images)])),
        fields=read_only(
            np.stack([one.fields for one in images]) if images else np.empty((0, num_limbs, 2, 1, 1), np.uint8)
        ),
        limbs=LIMBS,
        grid=images[0].grid if images else MapGrid((0.0, 0.0), (1.0, 1.0)),
    )


def _as_detections(camera: str, bodies: Sequence[tuple[int, Bodies]], num_joints: int) -> Detections:
    frame = np.repeat([frame for frame, _ in bodies], [len(one.score) for _, one in bodies]).astype(np.int64)
    return Detections(
        camera=camera,
        frame=read_only(frame),
        keypoints_px=read_only(
            np.concatenate([np.empty((0, num_joints, 2)), *(one.keypoints_px for _, one in bodies)])
        ),
        score=read_only(np.concatenate([np.empty((0, num_joints)), *(one.score for _, one in bodies)])),
        box_px=read_only(np.concatenate([np.empty((0, 4)), *(one.box_px for _, one in bodies)])),
    )


def bodies_in(detections: Detections, frames: range) -> Detections:
    """Those of some of a camera's frames."""
    rows = slice(*np.searchsorted(detections.frame, [frames.start, frames.stop]))
    return Detections(
        camera=detections.camera,
        frame=detections.frame[rows],
        keypoints_px=detections.keypoints_px[rows],
        score=detections.score[rows],
        box_px=detections.box_px[rows],
        damaged=detections.damaged[slice(*np.searchsorted(detections.damaged, [frames.start, frames.stop]))],
    )


def concatenate(chunks: Iterable[Detections], cameras: Sequence[str], num_joints: int) -> dict[str, Detections]:
    """Join the detections of chunks, camera by camera; each camera's chunks come in the order of time."""
    of_camera: dict[str, list[Detections]] = {camera: [] for camera in cameras}
    for chunk in chunks:
        of_camera[chunk.camera].append(chunk)
    # A camera's chunks are freed before those of the next one are joined.
    return {camera: _join(camera, of_camera.pop(camera), num_joints) for camera in cameras}


def _join(camera: str, chunks: Sequence[Detections], num_joints: int) -> Detections:
    return Detections(
        camera=camera,
        frame=np.concatenate([np.empty(0, np.int64), *(one.frame for one in chunks)]),
        keypoints_px=np.concatenate([np.empty((0, num_joints, 2)), *(one.keypoints_px for one in chunks)]),
        score=np.concatenate([np.empty((0, num_joints)), *(one.score for one in chunks)]),
        box_px=np.concatenate([np.empty((0, 4)), *(one.box_px for one in chunks)]),
        damaged=np.concatenate([no_frames(), *(one.damaged for one in chunks)]),
    )
