"""Decode and detect one range of time in all cameras: the map of a reconstruction."""

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from pipeline.data import Detections, read_only
from pipeline.detect.detector import Bodies, Detector
from pipeline.session import CaptureSession
from pipeline.video.decode import decode
from pipeline.video.timeline import frames_in


def detect_chunk(
    session: CaptureSession,
    span_s: tuple[float, float],
    detector: Detector,
    on_frame: Callable[[], None] = lambda: None,
) -> dict[str, Detections]:
    """Detect bodies in exactly the frames whose time is in ``[t0, t1)``.

    Parameters
    ----------
    span_s
        t0 and t1 on the session's clock.
    on_frame
        Called after each frame.

    Returns
    -------
        Detections by camera; frames are numbered from the start of each video.

    Raises
    ------
    InputError
        If a frame can't be decoded.
    """
    found = {}
    for camera, video in zip(session.cameras, session.videos, strict=True):
        frames = frames_in(session.times[camera.name], *span_s)
        bodies: list[tuple[int, Bodies]] = []
        for frame, image_rgb in decode(video, frames.start, frames.stop):
            bodies.append((frame, detector.detect(image_rgb)))
            on_frame()
        found[camera.name] = _as_detections(camera.name, bodies, len(detector.joints.names))
    return found


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


def concatenate(
    chunks: Iterable[dict[str, Detections]], cameras: Sequence[str], num_joints: int
) -> dict[str, Detections]:
    """Join the detections of consecutive chunks, camera by camera."""
    everything = list(chunks)
    return {
        camera: Detections(
            camera=camera,
            frame=np.concatenate([np.empty(0, np.int64), *(chunk[camera].frame for chunk in everything)]),
            keypoints_px=np.concatenate(
                [np.empty((0, num_joints, 2)), *(chunk[camera].keypoints_px for chunk in everything)]
            ),
            score=np.concatenate([np.empty((0, num_joints)), *(chunk[camera].score for chunk in everything)]),
            box_px=np.concatenate([np.empty((0, 4)), *(chunk[camera].box_px for chunk in everything)]),
        )
        for camera in cameras
    }
