"""Simulated people with hands: a hand of constant shape at each simulated wrist, seen by all cameras."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from pipeline.core.data.cameras import FrameTimes
from pipeline.core.data.detections import Detections
from pipeline.core.joints import COCO_17, SIDES, JointSet, finger_joints, hand_bones
from pipeline.geometry.camera import project
from pipeline.validation.simulation.scenes import Simulation

JOINTS = JointSet(
    names=(*COCO_17.names, *finger_joints("left"), *finger_joints("right")),
    bones=(*COCO_17.bones, *hand_bones("left"), *hand_bones("right")),
)
HANDS = [slice(17, 37), slice(37, 57)]
"""Columns of the left and of the right hand's fingers in ``JOINTS``."""


def _shape_m() -> Float[np.ndarray, "20 3"]:
    """Hand with spread fingers: along the forearm, across to the thumb, out of the palm."""
    roots = [(0.03, 0.03), (0.09, 0.03), (0.095, 0.01), (0.09, -0.01), (0.08, -0.03)]
    across = [0.8, 0.25, 0.05, -0.1, -0.3]
    return np.array(
        [
            [x + 0.025 * k, y + 0.025 * k * slope, 0.004 * k * k]
            for (x, y), slope in zip(roots, across, strict=True)
            for k in range(4)
        ]
    )


def hands_m(body_m: Float[np.ndarray, "*batch 17 3"]) -> Float[np.ndarray, "*batch 40 3"]:
    """Fingers of both hands of bodies: in line with the forearms, mirrored."""
    hands = []
    for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
        elbow, wrist = (body_m[..., COCO_17.index(f"{side}_{name}"), :] for name in ("elbow", "wrist"))
        along = wrist - elbow
        along /= np.linalg.norm(along, axis=-1, keepdims=True)
        across = np.cross(along, np.array([0.3, 0.5, 0.81]))
        across /= np.linalg.norm(across, axis=-1, keepdims=True)
        axes = np.stack([along, sign * across, np.cross(along, across)], axis=-2)
        hands.append(wrist[..., None, :] + _shape_m() @ axes)
    return np.concatenate(hands, axis=-2)


@dataclass(frozen=True)
class WholeBodies:
    """A simulation's detections with hands, and the true positions of the hands' joints at the output frames."""

    simulation: Simulation
    detections: Mapping[str, Detections]
    truth_m: Float[np.ndarray, "people frames 40 3"]


def _at(simulation: Simulation, times: FrameTimes) -> Float[np.ndarray, "people frames 17 3"]:
    """True bodies at the times of a camera, on straight lines between output frames."""
    base = simulation.timebase
    place = (times.time_s - base.start_time_s) * base.frame_rate_hz
    first = np.clip(place.astype(int), 0, base.num_frames - 2)
    share = (place - first)[None, :, None, None]
    return (1 - share) * simulation.truth_m[:, first] + share * simulation.truth_m[:, first + 1]


def with_hands(simulation: Simulation, noise_px: float = 1.0, score: float = 0.8) -> WholeBodies:
    """Add hands to all bodies that a simulated detector found."""
    rng = np.random.default_rng(5)
    detections = {}
    for camera in simulation.cameras:
        seen, person = simulation.detections[camera.name], simulation.identities[camera.name]
        fingers_m = hands_m(_at(simulation, simulation.times[camera.name]))[np.maximum(person, 0), seen.frame]
        fingers_px = project(camera, fingers_m) + rng.normal(0.0, noise_px, (*fingers_m.shape[:-1], 2))
        fingers_px[person < 0] = np.nan
        fingers_score = np.where(np.isfinite(fingers_px).all(-1), score, 0.0)
        detections[camera.name] = replace(
            seen,
            keypoints_px=np.concatenate([seen.keypoints_px, fingers_px], axis=1),
            score=np.concatenate([seen.score, fingers_score], axis=1),
        )
    return WholeBodies(simulation, detections, hands_m(simulation.truth_m))
