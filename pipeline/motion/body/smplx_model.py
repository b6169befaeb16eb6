"""Model of SMPL-X that the user supplies: read from its NPZ file without pickles, and posed at a few points.

The file is licensed by its makers, and nothing of it is a part of this package. Arrays: ``v_template`` (vertices, 3),
``shapedirs`` (vertices, 3, shapes), ``posedirs`` (vertices, 3, 486), ``J_regressor`` (55, vertices), ``weights``
(vertices, 55) and ``kintree_table`` (2, 55). Other arrays, some of which are pickles, are not read.
"""

import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from zipfile import BadZipFile, ZipFile

import numpy as np
from jaxtyping import Float, Int

from pipeline.core.errors import InputError, Problem
from pipeline.core.problems.request_codes import INVALID_VALUE
from pipeline.core.runtime.npz import open_archive
from pipeline.motion.body.smplx_joints import NUM_BODY, SMPLX_JOINTS

NUM_BETAS = 10
_MOST_VERTICES, _MOST_BYTES = 100_000, 2**30
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
        with ZipFile(path) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
        arrays = {}
        if size <= _MOST_BYTES:
            with open_archive(path) as opened:
                arrays = {name: np.asarray(opened[name]) for name in _NAMES}
        fault = _fault(arrays)
    except (OSError, ValueError, LookupError, TypeError, MemoryError, EOFError, RuntimeError, BadZipFile, zlib.error):
        fault = f"it lacks one of the arrays {', '.join(_NAMES)}, or is damaged"
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
    if not arrays:
        return "it is too large"
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
