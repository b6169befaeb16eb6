"""Similarity transforms of cameras: Umeyama's alignment of points, and of a rig's world with a given one."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera
from pipeline.core.data.rigid import Rigid3
from pipeline.geometry.camera import center_in_world

# Scales of the robust loss: a camera that differs by much more does not move the world.
_TURN_RAD, _SHIFT_M = np.radians(0.3), 0.02


def move_world(cameras: Sequence[Camera], new_from_old: Rigid3) -> tuple[Camera, ...]:
    """Cameras in another frame of the world."""
    old_from_new = new_from_old.inverse()
    return tuple(replace(camera, cam_from_world=camera.cam_from_world @ old_from_new) for camera in cameras)


class Similarity(NamedTuple):
    """Transform ``scale * rotation @ x + translation_m``; a mirrored one has a rotation of determinant -1."""

    scale: float
    rotation: Float[np.ndarray, "3 3"]
    translation_m: Float[np.ndarray, " 3"]

    def apply(self, points_m: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
        """Transform points."""
        moved: np.ndarray = self.scale * points_m @ self.rotation.T + self.translation_m
        return moved

    def moved(self, camera: Camera) -> Camera:
        """Camera in the world."""
        rotation = camera.cam_from_world.rotation @ self.rotation.T
        center_m = self.apply(center_in_world(camera))
        return replace(camera, cam_from_world=Rigid3(read_only(rotation), read_only(-rotation @ center_m)))


def umeyama(
    points_m: Float[np.ndarray, "points 3"],
    goal_m: Float[np.ndarray, "points 3"],
    has_scale: bool,
    is_mirrored: bool = False,
) -> Similarity:
    """Find the similarity with the least squares from points to their goals (Umeyama 1991, eq. 39 to 42).

    Without ``has_scale`` the scale is 1. With ``is_mirrored`` the best mirrored transform is looked for instead.
    """
    centre_m, goal_centre_m = points_m.mean(0), goal_m.mean(0)
    from_m, to_m = points_m - centre_m, goal_m - goal_centre_m
    left, values, right = np.linalg.svd(to_m.T @ from_m)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(left) * np.linalg.det(right)) * (-1.0 if is_mirrored else 1.0)])
    rotation = left @ np.diag(signs) @ right
    scale = float((values * signs).sum() / (from_m**2).sum()) if has_scale else 1.0
    return Similarity(scale, rotation, goal_centre_m - scale * rotation @ centre_m)


def align_world(given: Sequence[Camera], refined: Sequence[Camera]) -> tuple[Camera, ...]:
    """Move refined cameras by the similarity that brings most of them closest to the given cameras (Cauchy loss).

    Observations of a rig determine its cameras up to a shift, a turn and a growth of the world.
    """
    middle_m = np.mean([center_in_world(camera) for camera in given], axis=0)

    def residuals(step: Float[np.ndarray, " 7"]) -> Float[np.ndarray, " residuals"]:
        moved = [_similarity(step, middle_m).moved(camera) for camera in refined]
        return np.concatenate([_difference(then, now) for then, now in zip(given, moved, strict=True)])

    # From quadratic to robust, so that the start does not decide.
    step = least_squares(residuals, np.zeros(7), loss="linear", method="trf").x
    for scale in (10.0, 3.0, 1.0):
        step = least_squares(residuals, step, loss="cauchy", f_scale=scale, method="trf").x
    return tuple(_similarity(step, middle_m).moved(camera) for camera in refined)


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


def _similarity(step: Float[np.ndarray, " 7"], middle_m: Float[np.ndarray, " 3"]) -> Similarity:
    """Turn the world about a point by a rotation vector, shift it, and let it grow by a logarithm."""
    turn, growth = Rotation.from_rotvec(step[:3]).as_matrix(), float(np.exp(step[6]))
    return Similarity(growth, turn, middle_m - growth * (turn @ middle_m) + step[3:6])
