"""Size of a camera's images in a network's input, chosen by the size of the people in them.

MoveNet MultiPose locates joints best if the joints of a body span 220 to 240 pixels of its input. Smaller bodies are
located less accurately, and of bodies beyond about 280 pixels it loses joints. The size therefore belongs to people,
not to images.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from pipeline.core.data.turns import turned_axes
from pipeline.core.options.config import Profile
from pipeline.detection.bodies import ImageBodies

USUAL_PX = 512
"""Length of the longer side of an image without people."""

_MULTIPLE_PX = 32
_MIN_PX = 256
# Sizes within this share of the wanted one are as good: the one with the least padding is taken.
_TOLERANCE = 0.06
# Joints that make a body's size known, and the least confidence in them.
_MIN_JOINTS = 8
_MIN_SCORE = 0.2
# Tallest body of a frame that a quarter of the frames exceed, and likewise the smallest.
_TALL, _SMALL = 0.75, 0.25
# Two passes pay if the bodies differ as much: at one size, either the tall ones break or the small ones are coarse.
_TWO_PASS_RATIO = 2.6


@dataclass(frozen=True, slots=True)
class SizeRule:
    """Rule that chooses the size of images by the people in them."""

    span_px: float  # Pixels of the network's input that the joints of the tallest body shall span
    max_px: int  # Greatest length of the longer side of an image, which bounds the computing time


@dataclass(frozen=True, slots=True)
class CameraSizes:
    """Sizes of a camera's images in the network's input."""

    scaled_px: tuple[int, ...]  # Length of the longer side in each pass over an image, ascending: one pass, or two
    # Span of joints in pixels of the image from which on a body belongs to the first of two passes; ``None`` for one
    # pass
    border_px: float | None = None


@dataclass(frozen=True, slots=True)
class CameraLook:
    """How the images of a camera are shown to a network."""

    sizes: CameraSizes | None = None  # Their sizes; ``None``: the usual size of the network
    turn_deg: float = 0.0  # Counterclockwise turn that brings them upright


RULES: dict[Profile, SizeRule] = {
    "fast": SizeRule(span_px=180.0, max_px=640),
    "balanced": SizeRule(span_px=220.0, max_px=800),
    "accurate": SizeRule(span_px=230.0, max_px=800),
}
"""Rule of each profile; docs/lab/detection.md has the measurements."""


def body_spans_px(bodies: ImageBodies, turn_deg: float = 0.0) -> Float[np.ndarray, " n"]:
    """Longer side of the box around the sure joints of each body, in pixels; NaN with fewer than eight sure joints.

    The box is upright in the image turned counterclockwise by ``turn_deg``.
    """
    points_px = bodies.keypoints_px @ turned_axes(turn_deg) if turn_deg else bodies.keypoints_px
    sure = (bodies.score >= _MIN_SCORE) & np.isfinite(points_px).all(-1)
    low = np.where(sure[..., None], points_px, np.inf).min(1)
    high = np.where(sure[..., None], points_px, -np.inf).max(1)
    with np.errstate(invalid="ignore"):  # a body without sure joints
        longer = (high - low).max(-1)
    return np.where(sure.sum(-1) >= _MIN_JOINTS, longer, np.nan)


def choose_sizes(
    spans_px: Sequence[Float[np.ndarray, " _"]], image_size_px: tuple[int, int], rule: SizeRule
) -> CameraSizes:
    """Choose the sizes for a camera.

    ``spans_px``: spans of the bodies in some frames, an array a frame; NaN for a body of unknown size.
    ``image_size_px``: width and height of the camera's images, upright. Returns sizes at which the tallest bodies span
    ``rule.span_px``, within the limits. Two passes if the smallest bodies are far smaller. The usual size if there are
    no bodies.
    """
    known = [known_px for frame in spans_px if len(known_px := frame[np.isfinite(frame)])]
    if not known:
        return CameraSizes((_least_padded_px(float(USUAL_PX), image_size_px, rule),))
    tall_px = float(np.quantile([frame.max() for frame in known], _TALL))
    small_px = float(np.quantile([frame.min() for frame in known], _SMALL))
    coarse_px, fine_px = (
        _least_padded_px(rule.span_px / span_px * max(image_size_px), image_size_px, rule)
        for span_px in (tall_px, small_px)
    )
    if tall_px < _TWO_PASS_RATIO * small_px or fine_px <= coarse_px:
        return CameraSizes((coarse_px,))
    return CameraSizes((coarse_px, fine_px), math.sqrt(tall_px * small_px))


def _least_padded_px(wanted_px: float, image_size_px: tuple[int, int], rule: SizeRule) -> int:
    """Length of the longer side near a wanted one, within the limits, for which the least padding is computed in vain.

    Padding grows both sides to multiples of 32.
    """
    bounded_px = min(max(wanted_px, _MIN_PX), rule.max_px)
    low, high = math.ceil(bounded_px * (1 - _TOLERANCE)), math.floor(min(bounded_px * (1 + _TOLERANCE), rule.max_px))
    return min(range(low, high + 1), key=lambda px: (_padding(px, image_size_px), abs(px - bounded_px)))


def _padding(longer_px: int, image_size_px: tuple[int, int]) -> float:
    """Share of the network's input that padding adds to an image."""
    scale = longer_px / max(image_size_px)
    sides_px = [max(1, round(side * scale)) for side in image_size_px]
    padded_px = [math.ceil(side / _MULTIPLE_PX) * _MULTIPLE_PX for side in sides_px]
    # Rounded: a pixel more or less of 512 is no reason for another size.
    return round(math.prod(padded_px) / math.prod(sides_px), 2)
