"""Parameters of a camera in an adjustment, as a vector of 22 steps from the present camera.

Rotation in the camera's own axes (radians), shift of its centre (metres), logarithm of both focal lengths, logarithm of
their ratio fy / fx, principal point (pixels), and OpenCV's twelve distortion coefficients in OpenCV's order
(of a fisheye lens its four).
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera
from pipeline.core.data.rigid import Rigid3
from pipeline.geometry.camera import bend, center_in_world, twelve_coefficients
from pipeline.geometry.fisheye import fisheye_by_coefficients, fisheye_by_ideal

ROTATION, POSITION, EXTRINSICS = slice(0, 3), slice(3, 6), slice(0, 6)
FOCAL, ASPECT, PRINCIPAL, DISTORTION = slice(6, 7), slice(7, 8), slice(8, 10), slice(10, 22)
NUM_PARAMETERS = 22

Parameters = Float[np.ndarray, "cameras 22"]
Free = Bool[np.ndarray, "cameras 22"]


def none_free(num_cameras: int) -> Free:
    """Mask of the free parameters in which no parameter is free; set the free ones by the slices of this module."""
    return np.zeros((num_cameras, NUM_PARAMETERS), bool)


def no_prior(num_cameras: int) -> Parameters:
    """Standard deviations of parameters about which nothing is known: infinite."""
    return np.full((num_cameras, NUM_PARAMETERS), np.inf)


def move_camera(camera: Camera, step: Float[np.ndarray, " parameters"]) -> Camera:
    """Change a camera by a step of its parameters.

    The step is of all parameters, or of the first ones, and zero for coefficients that the camera does not have.
    """
    if not step.any():
        return camera
    step = np.pad(step, (0, NUM_PARAMETERS - len(step)))
    rotation = Rotation.from_rotvec(step[ROTATION]).as_matrix() @ camera.cam_from_world.rotation
    center_m = center_in_world(camera) + step[POSITION]
    matrix = camera.matrix.copy()
    matrix[:2, :2] *= np.exp(step[FOCAL])
    matrix[1, 1] *= np.exp(step[ASPECT][0])
    matrix[:2, 2] += step[PRINCIPAL]
    return replace(
        camera,
        matrix=read_only(matrix),
        distortion=read_only(camera.distortion + step[DISTORTION][: len(camera.distortion)]),
        cam_from_world=Rigid3(read_only(rotation), read_only(-rotation @ center_m)),
    )


def offsets(given: Sequence[Camera], cameras: Sequence[Camera]) -> Parameters:
    """Parameters of cameras relative to given ones: the steps of ``move_camera`` that lead to the cameras."""
    return np.array([_offset(then, now) for then, now in zip(given, cameras, strict=True)])


def _offset(then: Camera, now: Camera) -> Float[np.ndarray, " 22"]:
    turn = now.cam_from_world.rotation @ then.cam_from_world.rotation.T
    log_ratio = np.log(now.matrix.diagonal()[:2] / then.matrix.diagonal()[:2])
    return np.concatenate(
        [
            Rotation.from_matrix(turn).as_rotvec(),
            center_in_world(now) - center_in_world(then),
            [log_ratio[0], log_ratio[1] - log_ratio[0]],
            now.matrix[:2, 2] - then.matrix[:2, 2],
            twelve_coefficients(now.distortion) - twelve_coefficients(then.distortion),
        ]
    )


def world_moves(cameras: Sequence[Camera]) -> Float[np.ndarray, "cameras 22 7"]:
    """Derivatives of the cameras' parameters by a shift of the world (metres), a turn (radians) and a growth of it."""
    centers_m = np.array([center_in_world(camera) for camera in cameras])
    arms_m = centers_m - centers_m.mean(0)
    moves = np.zeros((len(cameras), NUM_PARAMETERS, 7))
    moves[:, POSITION, 0:3] = np.eye(3)
    for axis in range(3):
        moves[:, POSITION, 3 + axis] = np.cross(np.eye(3)[axis], arms_m)
        moves[:, ROTATION, 3 + axis] = [-camera.cam_from_world.rotation[:, axis] for camera in cameras]
    moves[:, POSITION, 6] = arms_m
    return moves


class Projection(NamedTuple):
    """Distorted projections and their derivatives; NaN for points behind the camera."""

    points_px: Float[np.ndarray, "points 2"]  # Distorted pixels
    by_camera: Float[np.ndarray, "points 2 22"]  # Derivatives by the parameters of ``adjustment.parameters``
    by_point: Float[np.ndarray, "points 2 3"]  # Derivatives by the points in the world, pixels a metre


def linearise(camera: Camera, xyz_m: Float[np.ndarray, "points 3"]) -> Projection:
    """Project points and differentiate; the model is the same as in ``geometry.camera.project``."""
    in_cam, ideal, from_principal, by_cam = _linearise_in_cam(camera, xyz_m)
    by_point = by_cam @ camera.cam_from_world.rotation
    by_aspect = np.zeros((len(xyz_m), 2, 1))
    by_aspect[:, 1, 0] = from_principal[:, 1]
    by_camera = np.concatenate(
        [
            np.cross(in_cam[:, None, :], by_cam),  # d(exp(w) x)/dw = -[x]_x
            -by_point,
            from_principal[:, :, None],
            by_aspect,
            np.tile(np.eye(2), (len(xyz_m), 1, 1)),
            camera.matrix[:2, :2] @ _by_coefficients(camera, ideal),
        ],
        axis=-1,
    )
    return Projection(from_principal + camera.matrix[:2, 2], by_camera, by_point)


def linearise_points(
    camera: Camera, xyz_m: Float[np.ndarray, "points 3"]
) -> tuple[Float[np.ndarray, "points 2"], Float[np.ndarray, "points 2 3"]]:
    """Project points and differentiate by the points alone: ``points_px`` and ``by_point`` of ``linearise``."""
    _, _, from_principal, by_cam = _linearise_in_cam(camera, xyz_m)
    return from_principal + camera.matrix[:2, 2], by_cam @ camera.cam_from_world.rotation


def _linearise_in_cam(camera: Camera, xyz_m: Float[np.ndarray, "points 3"]) -> tuple[np.ndarray, ...]:
    """Points in the camera and on its ideal plane, pixels from the principal point, derivatives in the camera."""
    in_cam = camera.cam_from_world.apply(xyz_m)
    depth_m = np.where(in_cam[:, 2] > 1e-6, in_cam[:, 2], np.nan)
    ideal = in_cam[:, :2] / depth_m[:, None]
    scale = camera.matrix[:2, :2]
    ideal_by_cam = np.zeros((len(xyz_m), 2, 3))
    ideal_by_cam[:, 0, 0] = ideal_by_cam[:, 1, 1] = 1.0 / depth_m
    ideal_by_cam[:, :, 2] = -ideal / depth_m[:, None]
    return in_cam, ideal, bend(camera, ideal) @ scale.T, scale @ _by_ideal(camera, ideal) @ ideal_by_cam


def _by_ideal(camera: Camera, ideal: Float[np.ndarray, "points 2"]) -> Float[np.ndarray, "points 2 2"]:
    """Derivatives of ``geometry.camera.bend`` by the points on the normalised image plane."""
    derivatives = fisheye_by_ideal if camera.lens == "fisheye" else distortion_by_ideal
    return derivatives(ideal, camera.distortion)


def _by_coefficients(camera: Camera, ideal: Float[np.ndarray, "points 2"]) -> Float[np.ndarray, "points 2 12"]:
    """Derivatives of ``geometry.camera.bend`` by the coefficients; 0 by those that a fisheye does not have."""
    if camera.lens == "standard":
        return distortion_by_coefficients(ideal, camera.distortion)
    derivatives = np.zeros((len(ideal), 2, 12))
    derivatives[..., : len(camera.distortion)] = fisheye_by_coefficients(ideal)
    return derivatives


def distortion_by_ideal(
    ideal: Float[np.ndarray, "points 2"], distortion: Float[np.ndarray, " coefficients"]
) -> Float[np.ndarray, "points 2 2"]:
    """Derivatives of ``geometry.camera.distort`` by the points on the normalised image plane."""
    k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4 = twelve_coefficients(distortion)
    x, y = ideal.T
    r2 = x * x + y * y
    over = 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / over
    # Derivative of the radial factor by r2: quotient rule.
    slope = (k1 + r2 * (2 * k2 + 3 * r2 * k3) - radial * (k4 + r2 * (2 * k5 + 3 * r2 * k6))) / over
    prism_x, prism_y = 2 * (s1 + 2 * s2 * r2), 2 * (s3 + 2 * s4 * r2)
    mixed = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
    rows = [
        [radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x + prism_x * x, mixed + prism_x * y],
        [mixed + prism_y * x, radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x + prism_y * y],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def distortion_by_coefficients(
    ideal: Float[np.ndarray, "points 2"], distortion: Float[np.ndarray, " coefficients"]
) -> Float[np.ndarray, "points 2 12"]:
    """Derivatives of ``geometry.camera.distort`` by OpenCV's twelve coefficients."""
    k1, k2, _, _, k3, k4, k5, k6 = twelve_coefficients(distortion)[:8]
    x, y = ideal.T
    r2 = x * x + y * y
    over = 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / over
    zero = np.zeros_like(r2)
    radially = [r2 / over, r2**2 / over, r2**3 / over]
    inversely = [-radial * factor for factor in radially]
    by_x = [2 * x * y, r2 + 2 * x * x]
    by_y = [r2 + 2 * y * y, 2 * x * y]
    rows = [
        [along * radially[0], along * radially[1], *tangential, along * radially[2]]
        + [along * factor for factor in inversely]
        + prism
        for along, tangential, prism in ((x, by_x, [r2, r2**2, zero, zero]), (y, by_y, [zero, zero, r2, r2**2]))
    ]
    return np.moveaxis(np.array(rows), -1, 0)
