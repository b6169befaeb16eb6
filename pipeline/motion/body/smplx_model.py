"""Model of SMPL-X that the user supplies: read from its NPZ file without pickles, and posed at a few points.

The file is licensed by its makers, and nothing of it is a part of this package. Arrays: ``v_template`` (vertices, 3),
``shapedirs`` (vertices, 3, shapes), ``posedirs`` (vertices, 3, 486), ``J_regressor`` (55, vertices), ``weights``
(vertices, 55) and ``kintree_table`` (2, 55). Other arrays, some of which are pickles, are not read.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from pipeline.core.errors import InputError, Problem
from pipeline.core.problems.request_codes import INVALID_VALUE
from pipeline.core.runtime.npz import read_untrusted_arrays
from pipeline.motion.body.smplx_joints import JOINT_MAP, NUM_BODY, SMPLX_JOINTS

NUM_BETAS = 10
_MOST_VERTICES, MOST_BYTES = 100_000, 2**30
_NAMES = ("v_template", "shapedirs", "posedirs", "J_regressor", "weights", "kintree_table")


@dataclass(frozen=True, slots=True, eq=False)
class SmplxModel:
    """Joints of a model without face and fingers, and a few of its vertices, by their shape and pose."""

    rest_m: Float[np.ndarray, "joints 3"]
    rest_by_beta: Float[np.ndarray, "joints 3 betas"]
    parents: Int[np.ndarray, " joints"]  # -1 of the first
    # Vertices on the skin: the landmarks that were asked for
    vertex_m: Float[np.ndarray, "points 3"]
    vertex_by_beta: Float[np.ndarray, "points 3 betas"]
    vertex_by_pose: Float[np.ndarray, "points 3 turns"]  # By the rotations of all joints but the first, less identity
    weights: Float[np.ndarray, "points joints"]

    def posed(
        self,
        betas: Float[np.ndarray, " betas"],
        turns: Float[np.ndarray, "frames joints 3 3"],
        trans_m: Float[np.ndarray, "frames 3"],
    ) -> tuple[Float[np.ndarray, "frames joints 3"], Float[np.ndarray, "frames points 3"]]:
        """Joints and points of a shape in poses, by linear blend skinning (Loper et al. 2015)."""
        rest_m = self.rest_m + self.rest_by_beta @ betas
        world, place_m = np.empty_like(turns), np.empty((*turns.shape[:2], 3))
        for joint, parent in enumerate(self.parents):
            if parent < 0:
                world[:, joint], place_m[:, joint] = turns[:, joint], rest_m[joint] + trans_m
                continue
            world[:, joint] = world[:, parent] @ turns[:, joint]
            place_m[:, joint] = place_m[:, parent] + world[:, parent] @ (rest_m[joint] - rest_m[parent])
        features = (turns[:, 1:] - np.eye(3)).reshape(len(turns), -1)
        shaped_m = self.vertex_m + self.vertex_by_beta @ betas + np.einsum("pkt,ft->fpk", self.vertex_by_pose, features)
        arms_m = shaped_m[:, :, None] - rest_m
        moved_m = np.einsum("fjab,fpjb->fpja", world, arms_m) + place_m[:, None]
        return place_m, np.einsum("pj,fpja->fpa", self.weights, moved_m)


def read_model(path: Path, landmarks: tuple[str, ...]) -> SmplxModel:
    """Read a model with the vertices of some landmarks: nose, ears, heels and big toes, found by their places.

    Raises ``InputError`` if the file is no model of SMPL-X.
    """
    try:
        arrays = read_untrusted_arrays(path, _NAMES, MOST_BYTES)
        fault = _fault(arrays)
    except ValueError as error:
        fault = str(error)
    except (LookupError, TypeError):
        fault = "its arrays have other shapes"
    if fault is not None:
        message = f"The file is no NPZ model of SMPL-X: {fault}."
        hint = "Use SMPLX_NEUTRAL.npz, SMPLX_FEMALE.npz or SMPLX_MALE.npz of its makers."
        raise InputError([Problem(INVALID_VALUE, message, file=path.name, field="body_model", hint=hint)])
    template, shapes, poses, regressor, weights, tree = arrays.values()
    betas = shapes[..., :NUM_BETAS].astype(float)
    rest_m = regressor @ template
    body_weights = _of_body(weights.astype(float), tree[0].astype(np.int64))
    rows = [_vertex(name, template, rest_m, body_weights) for name in landmarks]
    return SmplxModel(
        rest_m[:NUM_BODY],
        np.einsum("jv,vkb->jkb", regressor[:NUM_BODY], betas),
        np.r_[-1, tree[0, 1:NUM_BODY].astype(np.int64)],
        template[rows].astype(float),
        betas[rows],
        poses[rows][..., : 9 * (NUM_BODY - 1)].astype(float),
        body_weights[rows],
    )


def _fault(arrays: Mapping[str, np.ndarray]) -> str | None:
    """Reason why arrays are no model; ``None``: they are one."""
    num, joints, shapes = len(arrays["v_template"]), len(SMPLX_JOINTS), arrays["shapedirs"].shape[-1]
    expected = (num, 3), (num, 3, shapes), (num, 3, 9 * (joints - 1)), (joints, num), (num, joints), (2, joints)
    for (name, array), shape in zip(arrays.items(), expected, strict=True):
        if array.shape != shape or array.dtype.kind not in "fiu" or not np.isfinite(array).all():
            return f"{name} has not finite numbers in the shape {shape}"
    parents = arrays["kintree_table"][0, 1:].astype(np.int64)
    is_tree = ((parents >= 0) & (parents <= np.arange(joints - 1))).all()
    if not (0 < num <= _MOST_VERTICES and shapes >= NUM_BETAS and is_tree):
        return "its numbers of vertices, shapes or joints are others"
    return None


def _of_body(weights: Float[np.ndarray, "vertices all"], parents: Int[np.ndarray, " all"]) -> np.ndarray:
    """Weights of the body's joints, with the weights of face and fingers added to the joint that carries them."""
    summed = weights.copy()
    for joint in range(len(parents) - 1, NUM_BODY - 1, -1):
        summed[:, parents[joint]] += summed[:, joint]
    return summed[:, :NUM_BODY]


def _vertex(name: str, template: np.ndarray, rest_m: np.ndarray, weights: Float[np.ndarray, "vertices joints"]) -> int:
    """Vertex of a landmark at rest (Y up, facing Z, left along X): the farthest one of its body part in a direction."""
    side, _, kind = name.partition("_")
    out = 1.0 if side == "left" else -1.0
    parts = {
        "nose": (("head",), (0.0, 0.0, 1.0)),
        "ear": (("head",), (out, 0.0, 0.0)),
        "heel": ((f"{side}_ankle", f"{side}_foot"), (0.0, -0.3, -1.0)),
        "big_toe": ((f"{side}_ankle", f"{side}_foot"), (-0.2 * out, 0.0, 1.0)),
    }
    joints, direction = parts[kind or name]
    share = weights[:, [SMPLX_JOINTS.index(joint) for joint in joints]].sum(1)
    along = (template - rest_m[SMPLX_JOINTS.index(joints[0])]) @ np.array(direction)
    return int(np.where(share > 0.5, along, -np.inf).argmax())


# Fit of a model of SMPL-X to our joint centres and points on the skin: its shape, then its pose in every frame. The
# shape makes the model's bones as long as ours. Poses begin at our rotations, and move by Gauss-Newton steps until
# joints and points agree; a turn of a joint away from our rotation costs as much as a distance of 3 cm a radian.

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
