"""Detection in two passes of different sizes, where the people in one view differ much in size.

The coarse pass sees a small image, in which tall bodies have the size for which the network is made. The fine pass sees
a large image, for small bodies. There the network finds tall bodies in parts: these duplicate joints of the coarse
pass, and are removed.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, UInt8

from pipeline.core.data.arrays import read_only
from pipeline.core.joints import JointSet
from pipeline.detection.bodies import ImageBodies
from pipeline.detection.detector import Detector
from pipeline.detection.profiles.sizes import body_spans_px

# Two bodies are the same, or one is a part of the other, if this share of their common joints, and at least this
# number, is closer than this share of the larger body's span.
_SAME_SHARE = 0.5
_MIN_SAME = 2
_SAME_DISTANCE = 0.08


@dataclass(frozen=True, slots=True)
class TwoSizes:
    """Detector that merges two passes over an image."""

    # The same network with smaller and with larger images
    coarse: Detector
    fine: Detector
    border_px: float  # Span of joints in pixels of the image from which on a body is taken from the coarse pass

    @property
    def joints(self) -> JointSet:
        """Joints of the bodies."""
        return self.coarse.joints

    def detect(self, image_rgb: UInt8[np.ndarray, "height width 3"]) -> ImageBodies:
        """Detect the bodies in an image, in pixels of the image."""
        return merge_passes(
            self.coarse.detect(image_rgb), self.fine.detect(image_rgb), self.border_px, self.coarse.turn_deg
        )


def merge_passes(coarse: ImageBodies, fine: ImageBodies, border_px: float, turn_deg: float = 0.0) -> ImageBodies:
    """Merge the bodies of two passes over one image.

    Tall bodies come from the coarse pass. Bodies of the fine pass follow, unless they repeat a tall body or a part of
    it. The other bodies of the coarse pass are kept if the fine pass lacks them. A body is tall from a span of joints
    of ``border_px`` on, and not if its span is unknown; ``turn_deg`` is the same as for ``body_spans_px``. The bodies
    are in descending order of confidence.
    """
    is_tall = np.asarray(body_spans_px(coarse, turn_deg) >= border_px)
    tall, small = _select(coarse, is_tall), _select(coarse, ~is_tall)
    added = _select(fine, ~_repeats(fine, tall))
    kept = _select(small, ~_repeats(small, added) & ~_repeats(small, tall))
    return _by_confidence(tall, added, kept)


def _repeats(bodies: ImageBodies, others: ImageBodies) -> Bool[np.ndarray, " n"]:
    """Mark each body that shows the same person as one of the other bodies."""
    distance_px = np.linalg.norm(bodies.keypoints_px[:, None] - others.keypoints_px[None], axis=-1)
    num_common = np.isfinite(distance_px).sum(-1)
    span_px = np.maximum(_spans(bodies)[:, None], _spans(others)[None])
    num_near = (distance_px <= _SAME_DISTANCE * span_px[..., None]).sum(-1)
    is_same = (num_near >= _MIN_SAME) & (num_near >= _SAME_SHARE * num_common)
    return np.asarray(is_same.any(-1))


def _spans(bodies: ImageBodies) -> Float[np.ndarray, " n"]:
    return (bodies.box_px[:, 2:] - bodies.box_px[:, :2]).max(-1, initial=0.0)


def _select(bodies: ImageBodies, chosen: Bool[np.ndarray, " n"]) -> ImageBodies:
    return ImageBodies(
        bodies.keypoints_px[chosen], bodies.score[chosen], bodies.box_px[chosen], bodies.center_score[chosen]
    )


def _by_confidence(*parts: ImageBodies) -> ImageBodies:
    center_score = np.concatenate([part.center_score for part in parts])
    order = np.argsort(-center_score, kind="stable")
    return ImageBodies(
        keypoints_px=read_only(np.concatenate([part.keypoints_px for part in parts])[order]),
        score=read_only(np.concatenate([part.score for part in parts])[order]),
        box_px=read_only(np.concatenate([part.box_px for part in parts])[order]),
        center_score=read_only(center_score[order]),
    )
