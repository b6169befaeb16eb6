"""Detector of a reconstruction: the networks of a profile, at the image sizes of a camera."""

import functools
import threading
from collections.abc import Callable, Hashable, Mapping
from dataclasses import replace
from typing import Literal, TypeVar

from pipeline.core.errors import ModelError
from pipeline.core.joints import BODY_FEET, COCO_17, WHOLE_BODY, JointOffsets, JointSet
from pipeline.core.options.config import MotionChoices, Networks
from pipeline.detection.bodies import BodyDetector
from pipeline.detection.detector import Detector, open_detector
from pipeline.detection.entries import find_entry
from pipeline.detection.models import verify
from pipeline.detection.network import Network, open_network
from pipeline.detection.own.own_detectors import open_own
from pipeline.detection.profiles.sizes import CameraSizes
from pipeline.detection.profiles.two_sizes import TwoSizes
from pipeline.detection.registry import NetworkHead
from pipeline.detection.topdown.topdown_detector import TopDown

__all__ = [
    "BodyDetector",
    "detected_joint_set",
    "detection_joints",
    "load_detector",
    "load_landmarks",
    "load_own",
    "mark_offsets",
    "open_detection",
    "open_landmarks",
    "sized",
]

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


_JOINT_SETS: Mapping[str, JointSet] = {"body": COCO_17, "feet": BODY_FEET, "whole": WHOLE_BODY}

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


def detected_joint_set(networks: Networks, joints: Literal["body", "feet", "whole"]) -> JointSet:
    """Joints of the detections of a reconstruction.

    ``joints`` are the requested joints, see ``MotionChoices.detected_joints``; networks without crops have
    their own.
    """
    return find_entry(networks.body).joints if networks.near is None else _JOINT_SETS[joints]


def detection_joints(choices: MotionChoices) -> JointSet:
    """Joints that the networks of a reconstruction detect in videos."""
    return detected_joint_set(choices.networks, choices.detected_joints)


def mark_offsets(choices: MotionChoices) -> JointOffsets:
    """Offsets of the marks of these networks from the joints' centres."""
    networks = choices.networks
    is_refined = networks.near is not None and networks.refines_body
    return find_entry(networks.near if is_refined and networks.near else networks.body).offsets


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
