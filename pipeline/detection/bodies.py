"""Bodies that a detector finds in one image."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, UInt8

from pipeline.core.joints import JointSet


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


def boxes_around(keypoints_px: Float[np.ndarray, "n joints 2"]) -> Float[np.ndarray, "n 4"]:
    """x0, y0, x1, y1 around the joints of each body that are not NaN, of which there is at least one."""
    seen = np.isfinite(keypoints_px)
    low, high = np.where(seen, keypoints_px, np.inf).min(1), np.where(seen, keypoints_px, -np.inf).max(1)
    return np.concatenate([low, high], axis=-1)
