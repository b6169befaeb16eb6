"""Fit of a model of SMPL-X to our joint centres and points on the skin: its shape, then its pose in every frame.

The shape makes the model's bones as long as ours. Poses begin at our rotations, and move by Gauss-Newton steps until
joints and points agree; a turn of a joint away from our rotation costs as much as a distance of 3 cm a radian.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from pipeline.motion.body.smplx_joints import JOINT_MAP, NUM_BODY, SMPLX_JOINTS
from pipeline.motion.body.smplx_model import NUM_BETAS, SmplxModel

_KINDS = ("UpLeg", "Leg", "Foot", "Arm", "ForeArm", "Hand")
FITTED: tuple[str, ...] = tuple(f"{side}{kind}" for side in ("Left", "Right") for kind in _KINDS)
"""Our joints whose centres the model's joints have: the limbs' joints."""
_MODEL_JOINTS = [SMPLX_JOINTS.index(JOINT_MAP[name][0]) for name in FITTED]
_BONES = [
    (FITTED.index(f"{side}{first}"), FITTED.index(f"{side}{second}"))
    for side in ("Left", "Right")
    for first, second in (("UpLeg", "Leg"), ("Leg", "Foot"), ("Arm", "ForeArm"), ("ForeArm", "Hand"))
]
_ACROSS = [(FITTED.index(f"Left{kind}"), FITTED.index(f"Right{kind}")) for kind in ("UpLeg", "Arm")]
# Lengths that a standard deviation of a shape's number, and a radian of a joint's turn, stand for.
_M_PER_BETA, _M_PER_RAD = 0.003, 0.03
# Weight of lengths that a bent trunk and lifted shoulders shorten; the longest ones count.
_BENT = 0.2
_STEPS, _TURN_RAD, _BLOCK_FRAMES = 6, 1e-4, 256


class FittedBody(NamedTuple):
    """Shape and poses of a model."""

    betas: Float[np.ndarray, " betas"]
    poses: Float[np.ndarray, "frames joints 3"]  # Rotation vectors of ``SMPLX_JOINTS``
    trans_m: Float[np.ndarray, "frames 3"]
    error_m: Float[np.ndarray, "frames points"]  # Of each joint of ``FITTED``, then of each point; NaN: unknown


def fit_body(
    model: SmplxModel,
    joints_m: Mapping[str, Float[np.ndarray, "frames 3"]],
    points_m: Float[np.ndarray, "frames points 3"],
    poses: Float[np.ndarray, "frames joints 3"],
) -> FittedBody:
    """Fit a model to the joints of ``FITTED`` by name and to the points of the model's vertices, NaN where unknown."""
    goals_m = np.stack([joints_m[name] for name in FITTED], axis=1)
    betas = _shape(model, goals_m)
    fitted, trans_m = np.array(poses), np.empty((len(poses), 3))
    error_m = np.empty((len(poses), len(FITTED) + points_m.shape[1]))
    for start in range(0, len(poses), _BLOCK_FRAMES):
        rows = slice(start, start + _BLOCK_FRAMES)
        goal_m = np.concatenate([goals_m[rows], points_m[rows]], axis=1)
        fitted[rows, :NUM_BODY], trans_m[rows], error_m[rows] = _pose(model, betas, goal_m, poses[rows, :NUM_BODY])
    return FittedBody(betas, fitted, trans_m, error_m)


def _shape(model: SmplxModel, goals_m: Float[np.ndarray, "frames joints 3"]) -> Float[np.ndarray, " betas"]:
    pairs = np.array([*_BONES, *_ACROSS])
    wanted_m = np.nanquantile(np.linalg.norm(goals_m[:, pairs[:, 0]] - goals_m[:, pairs[:, 1]], axis=-1), 0.9, axis=0)
    middle_m = goals_m[:, _ACROSS].mean(2)
    trunk_m = float(np.nanquantile(np.linalg.norm(middle_m[:, 1] - middle_m[:, 0], axis=-1), 0.9))
    weight = np.r_[np.ones(len(_BONES)), np.full(len(_ACROSS) + 1, _BENT)]

    def residuals(betas: np.ndarray) -> np.ndarray:
        places_m = (model.rest_m + model.rest_by_beta @ betas)[_MODEL_JOINTS]
        lengths_m = np.linalg.norm(places_m[pairs[:, 0]] - places_m[pairs[:, 1]], axis=-1)
        across_m = places_m[_ACROSS].mean(1)
        trunk = np.linalg.norm(across_m[1] - across_m[0]) - trunk_m
        return np.r_[weight * np.r_[lengths_m - wanted_m, trunk], _M_PER_BETA * betas]

    return np.asarray(least_squares(residuals, np.zeros(NUM_BETAS)).x)


def _pose(
    model: SmplxModel, betas: np.ndarray, goal_m: Float[np.ndarray, "frames points 3"], poses: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    num_frames = len(poses)
    first = Rotation.from_rotvec(poses.reshape(-1, 3)).as_matrix().reshape(num_frames, NUM_BODY, 3, 3)
    known = np.isfinite(goal_m).all(-1, keepdims=True)
    numbers = np.zeros((num_frames, 3 * NUM_BODY + 3))  # turns from the first pose, in the joint's axes, and the place
    hips = model.posed(betas, first, numbers[:, -3:])[0][:, _MODEL_JOINTS]
    numbers[:, -3:] = np.nanmean(np.where(known, goal_m, np.nan)[:, : len(FITTED)] - hips, axis=1)

    def turned(values: np.ndarray) -> np.ndarray:
        turns = Rotation.from_rotvec(values[:, :-3].reshape(-1, 3)).as_matrix().reshape(first.shape)
        return np.asarray(first @ turns)

    def residuals(values: np.ndarray) -> np.ndarray:
        joints_m, points_m = model.posed(betas, turned(values), values[:, -3:])
        off_m = np.concatenate([joints_m[:, _MODEL_JOINTS], points_m], axis=1) - goal_m
        return np.where(known, off_m, 0.0).reshape(num_frames, -1)

    price = np.r_[np.full(3 * NUM_BODY, _M_PER_RAD**2), np.full(3, 1e-9)]
    for _ in range(_STEPS):
        now = residuals(numbers)
        slopes = np.empty((num_frames, now.shape[1], numbers.shape[1]))
        for column in range(numbers.shape[1]):
            moved = numbers.copy()
            moved[:, column] += _TURN_RAD
            slopes[:, :, column] = (residuals(moved) - now) / _TURN_RAD
        pull = np.einsum("frc,fr->fc", slopes, now) + price * numbers
        normal = np.einsum("frc,frd->fcd", slopes, slopes) + np.diag(price)
        numbers = numbers - np.linalg.solve(normal, pull[..., None])[..., 0]
    vectors = Rotation.from_matrix(turned(numbers).reshape(-1, 3, 3)).as_rotvec().reshape(num_frames, NUM_BODY, 3)
    error_m = np.linalg.norm(residuals(numbers).reshape(goal_m.shape), axis=-1)
    return vectors, numbers[:, -3:], np.where(known[..., 0], error_m, np.nan)
