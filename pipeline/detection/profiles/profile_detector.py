"""Detector of a reconstruction: the networks of a profile, at the image sizes of a camera."""

import functools
import threading
from collections.abc import Callable, Hashable
from dataclasses import dataclass, replace
from typing import Literal, TypeVar

import numpy as np
from jaxtyping import Bool, Float, UInt8

from pipeline.core.data.arrays import read_only
from pipeline.core.errors import ModelError
from pipeline.core.joints import JointSet
from pipeline.core.options.config import Networks
from pipeline.detection.bodies import BodyDetector, ImageBodies
from pipeline.detection.detector import Detector, open_detector
from pipeline.detection.entries import detected_joint_set, find_entry
from pipeline.detection.models import verify
from pipeline.detection.network import Network, open_network
from pipeline.detection.own.own_detectors import open_own
from pipeline.detection.profiles.sizes import CameraSizes, body_spans_px
from pipeline.detection.registry import NetworkHead
from pipeline.detection.topdown.topdown_detector import TopDown

# Detection in two passes of different sizes, where the people in one view differ much in size. The coarse pass sees a
# small image, in which tall bodies have the size for which the network is made. The fine pass sees a large image, for
# small bodies. There the network finds tall bodies in parts: these duplicate joints of the coarse pass, and are
# removed.

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


__all__ = ["BodyDetector", "load_detector", "load_landmarks", "load_own", "open_detection", "open_landmarks", "sized"]

_Key = TypeVar("_Key", bound=Hashable)
_Value = TypeVar("_Value")


def once_a_process(function: Callable[[_Key], _Value]) -> Callable[[_Key], _Value]:
    """Cache the values of a function of one argument; threads that ask for a value at the same time get the same one.

    ``functools.cache`` would call the function in each of them: a network would be loaded twice.
    """
    lock, cached = threading.Lock(), functools.cache(function)

    @functools.wraps(function)
    def locked(key: _Key) -> _Value:
        with lock:
            return cached(key)

    return locked


# Network that finds people for a network of crops of the user's own.
_FINDER = "movenet-multipose"

load_detector = once_a_process(open_detector)
"""``open_detector``, once a process for each network."""


def open_landmarks(name: str) -> Network:
    """Open an installed network of the registry that reads landmarks in crops.

    Raises ``ModelError`` if it is unknown, not installed or reads no crops, or its file was changed.
    """
    if not find_entry(name).head.reads_crops:
        raise ModelError(f"The network {name} reads no crops.")
    return open_network(verify(name))


load_landmarks = once_a_process(open_landmarks)
"""``open_landmarks``, once a process for each network."""


@once_a_process
def _load_network(name: str) -> Network:
    return open_network(verify(name))


def load_own(name: str, turn_deg: float = 0.0) -> BodyDetector:
    """Open a network of the user's own, once a process; MultiPose finds the people for networks of crops.

    ``turn_deg`` is the counterclockwise turn that brings images upright.
    """
    own = find_entry(name).own
    if own is None:
        raise ModelError(f"{name} is a network of the registry.")
    body = turned(load_detector(_FINDER), turn_deg) if own.reads_crops else None
    return open_own(_load_network(name), own, body, turn_deg)


def open_detection(
    networks: Networks,
    joints: Literal["body", "feet", "whole"],
    sizes: CameraSizes | None = None,
    turn_deg: float = 0.0,
) -> BodyDetector:
    """Open the networks of a reconstruction for the images of one camera.

    - ``networks``: networks by name; each is loaded once a process.
    - ``joints``: joints to detect; see ``MotionChoices.detected_joints``.
    - ``sizes``: image sizes of the camera; ``None``: the usual size of the network.
    - ``turn_deg``: counterclockwise turn that brings the camera's images upright.
    - Raises ``ModelError`` if a network is unknown or not installed, or its file was changed.
    """
    if find_entry(networks.body).own is not None:
        return load_own(networks.body, turn_deg)
    body = sized(turned(load_detector(networks.body), turn_deg), sizes)
    if networks.near is None:
        return body
    return TopDown(
        body,
        load_landmarks(networks.near),
        None if networks.hand is None else load_landmarks(networks.hand),
        networks.refines_body,
        detected_joint_set(networks, joints),
        turn_deg,
    )


def open_finder(networks: Networks, turn_deg: float = 0.0) -> BodyDetector:
    """Open the network that finds bodies in whole images at its usual size; see ``open_detection``."""
    if find_entry(networks.body).own is not None:
        return load_own(networks.body, turn_deg)
    return turned(load_detector(networks.body), turn_deg)


def shows_lean(networks: Networks) -> bool:
    """True if the network finds people in turned pictures, too, as MultiPose does, and shows how they lean."""
    return find_entry(networks.body).head is NetworkHead.MOVENET_MULTIPOSE


def turned(detector: Detector, turn_deg: float) -> Detector:
    """Detector that turns images counterclockwise before the network sees them; bodies are in pixels of the image."""
    return detector if turn_deg == 0.0 else replace(detector, turn_deg=turn_deg)


def sized(detector: Detector, sizes: CameraSizes | None) -> Detector | TwoSizes:
    """Detector at the image sizes of a camera: one pass, or two merged passes; ``None``: the detector as it is."""
    if sizes is None:
        return detector
    passes = [replace(detector, input=replace(detector.input, scaled_px=px)) for px in sizes.scaled_px]
    if sizes.border_px is None:
        return passes[0]
    coarse, fine = passes
    return TwoSizes(coarse, fine, sizes.border_px)
