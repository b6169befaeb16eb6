"""Decode and detect one range of one camera's frames: the map of a reconstruction."""

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from pipeline.data import Detections, read_only
from pipeline.detect.detector import Bodies, Detector
from pipeline.memory import give_pictures_back
from pipeline.session import CaptureSession
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
    InputError
        If a frame can't be decoded.
    """
    give_pictures_back()
    video = session.videos[[one.name for one in session.cameras].index(camera)]
    frames = frames_in(session.times[camera], *span_s)
    bodies: list[tuple[int, Bodies]] = []
    for frame, image_rgb in decode(video, frames.start, frames.stop):
        bodies.append((frame, detector.detect(image_rgb)))
        on_frame()
    return _as_detections(camera, bodies, len(detector.joints.names))


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


def concatenate(chunks: Iterable[Detections], cameras: Sequence[str], num_joints: int) -> dict[str, Detections]:
    """Join the detections of chunks, camera by camera; each camera's chunks come in the order of time."""
    of_camera: dict[str, list[Detections]] = {camera: [] for camera in cameras}
    for chunk in chunks:
        of_camera[chunk.camera].append(chunk)
    return {
        camera: Detections(
            camera=camera,
            frame=np.concatenate([np.empty(0, np.int64), *(one.frame for one in found)]),
            keypoints_px=np.concatenate([np.empty((0, num_joints, 2)), *(one.keypoints_px for one in found)]),
            score=np.concatenate([np.empty((0, num_joints)), *(one.score for one in found)]),
            box_px=np.concatenate([np.empty((0, 4)), *(one.box_px for one in found)]),
        )
        for camera, found in of_camera.items()
    }
