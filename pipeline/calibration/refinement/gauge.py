"""World of refined cameras: moved back to the world of the given ones.

Sightings determine cameras up to a shift, a turn and a growth of the world.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from pipeline.data import Camera, read_only
from pipeline.geometry.camera import center_in_world
from pipeline.geometry.rigid import Rigid3

# Scales of the robust loss: a camera that differs by much more does not move the world.
_TURN_RAD, _SHIFT_M = np.radians(0.3), 0.02


def align_world(given: Sequence[Camera], refined: Sequence[Camera]) -> tuple[Camera, ...]:
    """Move refined cameras by the similarity that brings most of them closest to the given cameras (Cauchy loss)."""
    middle_m = np.mean([center_in_world(camera) for camera in given], axis=0)

    def residuals(similarity: Float[np.ndarray, " 7"]) -> Float[np.ndarray, " residuals"]:
        moved = [_transformed(camera, similarity, middle_m) for camera in refined]
        return np.concatenate([_difference(then, now) for then, now in zip(given, moved, strict=True)])

    # From quadratic to robust, so that the start does not decide.
    similarity = least_squares(residuals, np.zeros(7), loss="linear", method="trf").x
    for scale in (10.0, 3.0, 1.0):
        similarity = least_squares(residuals, similarity, loss="cauchy", f_scale=scale, method="trf").x
    return tuple(_transformed(camera, similarity, middle_m) for camera in refined)


def turn_deg(then: Camera, now: Camera) -> float:
    """Angle in degrees between the orientations of two cameras."""
    turn = Rotation.from_matrix(now.cam_from_world.rotation @ then.cam_from_world.rotation.T)
    return float(np.degrees(turn.magnitude()))


def shift_m(then: Camera, now: Camera) -> float:
    """Distance in metres between the centres of two cameras."""
    return float(np.linalg.norm(center_in_world(now) - center_in_world(then)))


def _difference(then: Camera, now: Camera) -> Float[np.ndarray, " 6"]:
    turn = Rotation.from_matrix(now.cam_from_world.rotation @ then.cam_from_world.rotation.T).as_rotvec()
    return np.concatenate([turn / _TURN_RAD, (center_in_world(now) - center_in_world(then)) / _SHIFT_M])


def _transformed(camera: Camera, similarity: Float[np.ndarray, " 7"], middle_m: Float[np.ndarray, " 3"]) -> Camera:
    """Turn the world about a point by a rotation vector, let it grow by a logarithm, and shift it."""
    turn = Rotation.from_rotvec(similarity[:3]).as_matrix()
    arm_m = center_in_world(camera) - middle_m
    center_m = middle_m + np.exp(similarity[6]) * (turn @ arm_m) + similarity[3:6]
    rotation = camera.cam_from_world.rotation @ turn.T
    return replace(camera, cam_from_world=Rigid3(read_only(rotation), read_only(-rotation @ center_m)))
