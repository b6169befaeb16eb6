"""Bodies that a detector finds: in one image, in some frames of a camera, in all."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, UInt8

from pipeline.core.data.arrays import no_colours, no_frames, read_only
from pipeline.core.data.detections import Detections
from pipeline.core.joints import JointSet
from pipeline.detection.damage import join_changes


@dataclass(frozen=True, slots=True, eq=False)
class ImageBodies:
    """Bodies in one image, in descending order of confidence."""

    # Joints in pixels; (0, 0) is the centre of the first pixel. NaN where the detector found no joint.
    keypoints_px: Float[np.ndarray, "n joints 2"]
    score: Float[np.ndarray, "n joints"]  # The detector's confidence in [0, 1], 0 where the joint is NaN
    box_px: Float[np.ndarray, "n 4"]  # x0, y0, x1, y1 around the joints of each body
    center_score: Float[np.ndarray, " n"]  # The detector's confidence in [0, 1] in each body


@runtime_checkable
class BodyDetector(Protocol):
    """Detector of bodies in single images."""

    @property
    def joints(self) -> JointSet:
        """Joints of the bodies."""

    def detect(self, image_rgb: UInt8[np.ndarray, "height width 3"]) -> ImageBodies:
        """Detect the bodies in an image, in pixels of the image."""


def boxes_around(keypoints_px: Float[np.ndarray, "*batch joints 2"]) -> Float[np.ndarray, "*batch 4"]:
    """x0, y0, x1, y1 around the joints of each body that are not NaN, of which there is at least one."""
    seen = np.isfinite(keypoints_px)
    low, high = np.where(seen, keypoints_px, np.inf).min(-2), np.where(seen, keypoints_px, -np.inf).max(-2)
    return np.concatenate([low, high], axis=-1)


def stack_bodies(camera: str, numbered: Sequence[tuple[int, ImageBodies]], num_joints: int) -> Detections:
    """Stack the bodies of some frames, in ascending order of the frames, to detections of a camera."""
    frame = np.repeat([frame for frame, _ in numbered], [len(bodies.score) for _, bodies in numbered]).astype(np.int64)
    return Detections(
        camera=camera,
        frame=read_only(frame),
        keypoints_px=read_only(
            np.concatenate([np.empty((0, num_joints, 2)), *(bodies.keypoints_px for _, bodies in numbered)])
        ),
        score=read_only(np.concatenate([np.empty((0, num_joints)), *(bodies.score for _, bodies in numbered)])),
        box_px=read_only(np.concatenate([np.empty((0, 4)), *(bodies.box_px for _, bodies in numbered)])),
    )


def concatenate(chunks: Iterable[Detections], cameras: Sequence[str], num_joints: int) -> dict[str, Detections]:
    """Concatenate the detections of chunks camera by camera. Chunks of a camera are in order of time."""
    of_camera: dict[str, list[Detections]] = {camera: [] for camera in cameras}
    for chunk in chunks:
        of_camera[chunk.camera].append(chunk)
    # The chunks of a camera are freed before the chunks of the next camera are joined.
    return {camera: _join(camera, of_camera.pop(camera), num_joints) for camera in cameras}


def _join(camera: str, chunks: Sequence[Detections], num_joints: int) -> Detections:
    return Detections(
        camera=camera,
        frame=np.concatenate([np.empty(0, np.int64), *(chunk.frame for chunk in chunks)]),
        keypoints_px=np.concatenate([np.empty((0, num_joints, 2)), *(chunk.keypoints_px for chunk in chunks)]),
        score=np.concatenate([np.empty((0, num_joints)), *(chunk.score for chunk in chunks)]),
        box_px=np.concatenate([np.empty((0, 4)), *(chunk.box_px for chunk in chunks)]),
        damaged=np.concatenate([no_frames(), *(chunk.damaged for chunk in chunks)]),
        colour=join_colours([chunk.colour for chunk in chunks]),
        changes=join_changes([chunk.changes for chunk in chunks]),
    )


def join_colours(colours: Sequence[UInt8[np.ndarray, "_ _ _"]]) -> UInt8[np.ndarray, "_ _ _"]:
    """Concatenate colours of bodies, (bodies, parts, bins); pieces without bodies need not have parts and bins."""
    measured = [colour for colour in colours if len(colour)]
    return read_only(np.concatenate(measured)) if measured else no_colours()
