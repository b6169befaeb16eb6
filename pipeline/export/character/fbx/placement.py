"""Models of an FBX file: their tree, and where each one is when the mesh is bound to the bones.

The place of a model in its parent follows the FBX SDK's documentation, "Computing transformation matrices":
``T Roff Rp Rpre R Rpost^-1 Rp^-1 Soff Sp S Sp^-1``. Files are often saved in the middle of a movement. So a bone rests
where a cluster of a skin states that it was bound (``TransformLink``), else where the pose ``BindPose`` has it, and
only else where its settings put it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from pipeline.core.problems.session_codes import CHARACTER_TOO_LARGE
from pipeline.export.character.fbx.content import EXPORT_AGAIN, FbxContent
from pipeline.export.character.rig import MAX_LEVELS, MAX_NODES, MAX_SCALE, MIN_SCALE, CharacterFileError
from pipeline.export.writers.fbx_nodes import FbxError, Node
from pipeline.export.writers.fbx_scene import ROTATION, ROTATION_ORDERS, TRANSLATION
from pipeline.export.writers.fbx_stored import typed_property

SCALING = "Lcl Scaling"
"""Setting of a model: its scales."""

_LIMBS = frozenset({"LimbNode", "Limb", "Root"})
# ``InheritType`` of models that are not scaled as their parent is.
_WITHOUT_SCALES = 2.0
_ZERO, _ONE = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)
_CM_PER_M = 100.0
# Units of a file in centimetres; others are damage.
_MIN_UNIT_CM, _MAX_UNIT_CM = 1e-6, 1e6


@dataclass(frozen=True, slots=True, eq=False)
class BoundCluster:
    """Vertices of a mesh that a bone moves."""

    bone: int  # Model
    node: Node
    link: Float[np.ndarray, "4 4"]  # Matrix from the bone to the scene when the mesh was bound


class ModelTree:
    """Models of a file by their ids; matrices are in the file's axes and unit."""

    def __init__(self, content: FbxContent) -> None:
        self._content = content
        self.models = {number: node for number, node in content.scene.objects.items() if node.name == "Model"}
        if len(self.models) > MAX_NODES:
            message = f"The file has {len(self.models):,} models; at most {MAX_NODES:,} are read."
            raise CharacterFileError(message, CHARACTER_TOO_LARGE, "Leave out what is not the character.")
        if not self.models:
            raise CharacterFileError("The file has no models.", hint=EXPORT_AGAIN)
        self.parents = {number: content.scene.parent(number, "Model") for number in self.models}
        self.order = self._order()
        self.clusters = self._clusters()

    def _order(self) -> tuple[int, ...]:
        """Models, parents before their children."""
        levels: dict[int, int] = {}
        for start in self.models:
            way: list[int] = []
            above: int | None = start
            while above is not None and above not in levels:
                if len(way) > MAX_LEVELS:
                    message = f"Models are in a circle, or have more than {MAX_LEVELS} levels."
                    raise CharacterFileError(message, hint=EXPORT_AGAIN)
                way.append(above)
                above = self.parents[above]
            first = 0 if above is None else levels[above] + 1
            levels |= {number: level for level, number in enumerate(reversed(way), first)}
        return tuple(sorted(self.models, key=lambda number: levels[number]))

    def _clusters(self) -> Mapping[int, tuple[BoundCluster, ...]]:
        scene, found = self._content.scene, {}
        for geometry in (number for number, node in scene.objects.items() if node.name == "Geometry"):
            clusters = []
            for skin in scene.children(geometry, "Deformer"):
                if typed_property(scene.objects[skin], 2, str) != "Skin":
                    continue
                for cluster in scene.children(skin, "Deformer"):
                    node = scene.objects[cluster]
                    link = self._content.matrix(node, "TransformLink")
                    bone = next(scene.children(cluster, "Model"), None)
                    if bone is not None and link is not None:
                        clusters.append(BoundCluster(bone, node, link))
            if clusters:
                found[geometry] = tuple(clusters)
        return found

    @cached_property
    def bones(self) -> frozenset[int]:
        """Models of bones: those that are so called, and those that move a mesh."""
        called = {number for number, node in self.models.items() if typed_property(node, 2, str) in _LIMBS}
        return frozenset(called | {cluster.bone for clusters in self.clusters.values() for cluster in clusters})

    @cached_property
    def worlds(self) -> Mapping[int, Float[np.ndarray, "4 4"]]:
        """Matrix from each model to the scene in the rest pose."""
        bound = self._bound()
        worlds: dict[int, Float[np.ndarray, "4 4"]] = {}
        for number in self.order:
            if number in bound:
                worlds[number] = bound[number]
                continue
            parent = self.parents[number]
            local = self._local(self.models[number])
            worlds[number] = local if parent is None else worlds[parent] @ local
            if parent is not None and self._content.number(self.models[number], "InheritType", 1.0) == _WITHOUT_SCALES:
                scales = self._scales(self.models[parent], SCALING)
                worlds[number][:3, :3] = worlds[parent][:3, :3] / scales @ local[:3, :3]
            if not np.isfinite(worlds[number]).all():
                raise CharacterFileError("Places of models are not finite numbers.", hint=EXPORT_AGAIN)
        return worlds

    def _bound(self) -> dict[int, Float[np.ndarray, "4 4"]]:
        """Matrices of the models whose place in the rest pose the file states."""
        scene = self._content.scene
        found: dict[int, Float[np.ndarray, "4 4"]] = {}
        for clusters in self.clusters.values():
            for cluster in clusters:
                found.setdefault(cluster.bone, cluster.link)
        for pose in scene.find_all("Pose", "BindPose").values():
            for node in (child for child in pose.children if child.name == "PoseNode"):
                named, matrix = node.child("Node"), self._content.matrix(node, "Matrix")
                if named is not None and matrix is not None:
                    found.setdefault(typed_property(named, 0, int), matrix)
        return found

    def _local(self, node: Node) -> Float[np.ndarray, "4 4"]:
        """Matrix from a model to its parent by its settings."""
        content = self._content
        rotation_pivot, scaling_pivot = (
            content.vector(node, name, _ZERO) for name in ("RotationPivot", "ScalingPivot")
        )
        place = (
            content.vector(node, TRANSLATION, _ZERO) + content.vector(node, "RotationOffset", _ZERO) + rotation_pivot
        )
        between = content.vector(node, "ScalingOffset", _ZERO) + scaling_pivot - rotation_pivot
        matrix = np.eye(4)
        matrix[:3, :3] = self._turn(node)
        matrix[:3, 3] = place + matrix[:3, :3] @ between
        scales = self._scales(node, SCALING)
        matrix[:3, 3] -= matrix[:3, :3] @ (scales * scaling_pivot)
        matrix[:3, :3] *= scales
        return matrix

    def _turn(self, node: Node) -> Float[np.ndarray, "3 3"]:
        content = self._content
        angles_deg = content.vector(node, ROTATION, _ZERO)
        is_plain = content.number(node, "RotationActive", 1.0) == 0.0
        if is_plain or content.number(node, "RotationSpaceForLimitOnly", 0.0) != 0.0:
            return euler_matrix(angles_deg)
        before, behind = (euler_matrix(content.vector(node, name, _ZERO)) for name in ("PreRotation", "PostRotation"))
        return before @ euler_matrix(angles_deg, int(content.number(node, "RotationOrder", 0.0))) @ behind.T

    def _scales(self, node: Node, name: str) -> Float[np.ndarray, " 3"]:
        """Scales of a model; those that are zero, which hide it, are very small."""
        scales = self._content.vector(node, name, _ONE)
        if np.abs(scales).max() > MAX_SCALE:
            raise CharacterFileError("A model is too large.", hint=EXPORT_AGAIN)
        return np.where(np.abs(scales) < MIN_SCALE, MIN_SCALE, scales)

    def geometric(self, number: int) -> Float[np.ndarray, "4 4"]:
        """Matrix from the geometry of a model to the model."""
        node, matrix = self.models[number], np.eye(4)
        turned = euler_matrix(self._content.vector(node, "GeometricRotation", _ZERO))
        matrix[:3, :3] = turned * self._scales(node, "GeometricScaling")
        matrix[:3, 3] = self._content.vector(node, "GeometricTranslation", _ZERO)
        return matrix

    def ancestors(self, number: int) -> tuple[int, ...]:
        """A model and all models above it, from the model up."""
        models = [number]
        while (above := self.parents[models[-1]]) is not None:
            models.append(above)
        return tuple(models)


def euler_matrix(angles_deg: Float[np.ndarray, " 3"], order: int = 0) -> Float[np.ndarray, "3 3"]:
    """Rotation by angles about x, y and z, in one of the orders of ``ROTATION_ORDERS``; others count as the first."""
    axes = ROTATION_ORDERS[order if 0 <= order < len(ROTATION_ORDERS) else 0]
    angles = [angles_deg["XYZ".index(axis)] for axis in axes]
    return np.asarray(Rotation.from_euler(axes, angles, degrees=True).as_matrix())


def file_axes(content: FbxContent) -> tuple[float, Float[np.ndarray, "3 3"]]:
    """Unit of a file in metres, and the rotation from its axes to GLB's axes, with Y up.

    Raises ``CharacterFileError`` if the axes are not right-handed, or the unit is none.
    """
    node, axes = content.scene.global_settings, np.zeros((3, 3))
    for row, (name, usual) in enumerate((("CoordAxis", 0.0), ("UpAxis", 1.0), ("FrontAxis", 2.0))):
        axis, sign = content.number(node, name, usual), content.number(node, f"{name}Sign", 1.0)
        if axis not in (0.0, 1.0, 2.0):
            raise CharacterFileError("The file names an axis that does not exist.", hint=EXPORT_AGAIN)
        axes[row, int(axis)] = 1.0 if sign > 0.0 else -1.0
    if np.linalg.det(axes) < 0.5:
        message = "The axes of the file are not right-handed."
        raise CharacterFileError(message, hint="Export the character with right-handed axes, for example Y up.")
    unit_cm = content.number(node, "UnitScaleFactor", 1.0)
    if not _MIN_UNIT_CM <= unit_cm <= _MAX_UNIT_CM:
        raise CharacterFileError("The file has no usable unit of length.", hint=EXPORT_AGAIN)
    return unit_cm / _CM_PER_M, axes


Matrix = Float[np.ndarray, "4 4"]

INFLUENCES = 4
"""Largest number of bones that move a point: those with the largest weights."""


@dataclass(frozen=True, slots=True, eq=False)
class BoundPoints:
    """Bones that move the points of a surface, and where they are in the rest pose."""

    # Models and their weights, whose sum is 1; unused places have the weight 0
    bones: Int[np.ndarray, "points influences"]
    weights: Float[np.ndarray, "points influences"]
    # Matrix from the surface to the scene, the mean of the bones' matrices by their weights
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
    bone = next((above for above in tree.ancestors(model) if above in tree.bones), None)
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
