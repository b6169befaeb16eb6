"""Parameters of a camera in an adjustment, as a vector of 22 steps from the present camera.

Rotation in the camera's own axes (radians), shift of its centre (metres), logarithm of both focal lengths, logarithm of
their ratio fy / fx, principal point (pixels), and OpenCV's twelve distortion coefficients in OpenCV's order
(of a fisheye lens its four).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera
from pipeline.core.data.rigid import Rigid3
from pipeline.geometry.camera import center_in_world, twelve_coefficients

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
