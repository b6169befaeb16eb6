"""Skins of an FBX file: points of a surface in the rest pose, with the bones that move them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from pipeline.export.character.fbx.content import FbxContent
from pipeline.export.character.fbx.placement import ModelTree
from pipeline.export.writers.fbx_nodes import FbxError

Matrix = Float[np.ndarray, "4 4"]

INFLUENCES = 4
"""Largest number of bones that move a point: those with the largest weights."""


@dataclass(frozen=True, slots=True, eq=False)
class BoundPoints:
    """Bones that move the points of a surface, and where they are in the rest pose."""

    # Models and their weights, whose sum is 1; unused places have the weight 0
    bones: Int[np.ndarray, "points influences"]
    weights: Float[np.ndarray, "points influences"]
    # Matrix from the surface to the scene, the mean of those of the bones by their weights
    matrices: Float[np.ndarray, "points 3 4"]


def bind(
    content: FbxContent, tree: ModelTree, model: int, geometry: int, num_points: int, scene_from_file: Matrix
) -> BoundPoints | None:
    """Bind the points of a model's geometry to bones; ``None`` if neither a skin nor a bone above moves them.

    Points without weights move with the bone above the model, or with the first bone of the skin. The scene has axes
    and a unit of its own. Raises ``FbxError`` or ``CharacterFileError`` if the skin is damaged.
    """
    geometric = tree.geometric(model)
    clusters = tree.clusters.get(geometry, ())
    matrices = [tree.worlds[model] @ geometric]
    bone = tree.bone_above(model)
    if bone is None and not clusters:
        return None
    bones = [clusters[0].bone if bone is None else bone]
    rows: list[tuple[Int[np.ndarray, " moved"], int, Float[np.ndarray, " moved"]]] = []
    place_of: dict[int, int] = {}
    for cluster in clusters:
        bone_from_mesh = content.matrix(cluster.node, "Transform")
        if bone_from_mesh is None:
            bone_from_mesh = np.linalg.inv(cluster.link) @ tree.worlds[model]
        vertices, weights = content.integers(cluster.node, "Indexes"), content.reals(cluster.node, "Weights")
        if vertices is None or weights is None:
            continue
        if len(vertices) != len(weights) or (len(vertices) and not 0 <= vertices.min() <= vertices.max() < num_points):
            raise FbxError("a skin names vertices that its mesh lacks")
        if not rows:
            # The bones tell the place of the mesh when it was bound, for points that none of them moves too.
            matrices[0] = tree.worlds[cluster.bone] @ bone_from_mesh @ geometric
        if cluster.bone not in place_of:
            place_of[cluster.bone] = len(bones)
            bones.append(cluster.bone)
            matrices.append(tree.worlds[cluster.bone] @ bone_from_mesh @ geometric)
        rows.append((vertices.astype(np.int64), place_of[cluster.bone], weights[:, 0]))
    places, weights = _strongest(rows, num_points)
    blended = np.zeros((num_points, 3, 4))
    all_matrices = (scene_from_file @ np.array(matrices))[:, :3]
    for influence in range(INFLUENCES):
        blended += weights[:, influence, None, None] * all_matrices[places[:, influence]]
    return BoundPoints(np.array(bones)[places], weights, blended)


def _strongest(
    rows: Sequence[tuple[Int[np.ndarray, " _"], int, Float[np.ndarray, " _"]]], num_points: int
) -> tuple[Int[np.ndarray, "points influences"], Float[np.ndarray, "points influences"]]:
    """Places of the bones with the largest weights at each point, and these weights with the sum 1; else place 0."""
    places = np.zeros((num_points, INFLUENCES), np.int64)
    weights = np.zeros((num_points, INFLUENCES))
    if rows:
        num_places = max(place for _, place, _ in rows) + 1
        named = np.concatenate([vertices * num_places + place for vertices, place, _ in rows])
        # A skin may name a vertex of a bone twice.
        keys, at = np.unique(named, return_inverse=True)
        sizes = np.bincount(at, np.maximum(np.concatenate([shares for _, _, shares in rows]), 0.0), len(keys))
        points, of_points = np.divmod(keys, num_places)
        order = np.lexsort((-sizes, points))
        points, of_points, sizes = points[order], of_points[order], sizes[order]
        starts = np.flatnonzero(np.diff(points, prepend=-1))
        ranks = np.arange(len(points)) - np.repeat(starts, np.diff(np.append(starts, len(points))))
        is_kept = (ranks < INFLUENCES) & (sizes > 0.0)
        kept = points[is_kept], ranks[is_kept]
        places[kept], weights[kept] = of_points[is_kept], sizes[is_kept]
    weights[weights.sum(1) <= 0.0, 0] = 1.0
    return places, weights / weights.sum(1, keepdims=True)
