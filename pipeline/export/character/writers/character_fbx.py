"""FBX (binary) of a character in motion: its bones as they rest, its mesh bound to them, and curves of their rotations.

Axes are Maya's: Y up, right-handed; the unit is a centimetre, a hundredth of the character's. Models of the
bones have the names, places, rotations and scales of the character's file, below a node with the person's name. The
mesh has normals, places in pictures, and the colour of its materials; pictures are left out. The animation has a key in
each frame, and the mesh is visible while the person is there.
"""

import errno
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Float32, Int
from scipy.spatial.transform import Rotation

from pipeline.core.data.arrays import read_only
from pipeline.export.character.gltf_reader import CharacterFile, GltfDocument, objects_in
from pipeline.export.character.rig import CharacterRig, checked
from pipeline.export.character.writers.posed import PosedCharacter, chained_places, together
from pipeline.export.presets import Y_UP_FROM_WORLD
from pipeline.export.timelines import frame_blocks
from pipeline.export.writers.euler import euler_deg, turned
from pipeline.export.writers.fbx import ORIGIN, add_top
from pipeline.export.writers.fbx_drawn import BoundVertices, add_material, add_mesh, add_skin
from pipeline.export.writers.fbx_nodes import FbxError, Int64, Node, read, write
from pipeline.export.writers.fbx_scene import ROTATION, SCENE, TRANSLATION, Clip, FbxScene, local, safe_name, vector
from pipeline.export.writers.fbx_stored import StoredScene, has_setting, numbers, object_name

_TRIANGLES = 4
_INFLUENCES = 4
_PLAIN_RGB = (200, 200, 200)
_GAMMA = 2.2


@dataclass(frozen=True, slots=True, eq=False)
class MeshPart:
    """Part of a mesh with one material."""

    name: str
    positions: Float[np.ndarray, "vertices 3"]  # Places in the scene in the rest pose, in the file's axes and unit
    normals: Float[np.ndarray, "vertices 3"]
    uv: Float[np.ndarray, "vertices 2"] | None  # Places in the material's picture, from its upper left corner
    triangles: Int[np.ndarray, "triangles 3"]
    # Nodes that move a vertex, and their weights, whose sum is 1
    bones: Int[np.ndarray, "vertices influences"]
    weights: Float[np.ndarray, "vertices influences"]
    rgb: tuple[int, int, int]  # Colour of the material


def mesh_parts(file: CharacterFile) -> list[MeshPart]:
    """Parts of all meshes of a character that are made of triangles; those in compressed form are left out.

    Raises ``InputError`` if a mesh is damaged.
    """
    with checked(file.name):
        document = GltfDocument(dict(file.document), file.binary)
        parts = []
        for number, node in enumerate(document.nodes):
            if "mesh" in node:
                mesh = document.meshes[document.index(node, "mesh", document.meshes)]
                skin = document.index(node, "skin", document.skins) if "skin" in node else None
                for primitive in objects_in(mesh, "primitives"):
                    part = _part(file, document, number, skin, primitive)
                    if part is not None and len(part.triangles):
                        parts.append(part)
        return parts


def _part(
    file: CharacterFile, document: GltfDocument, node: int, skin: int | None, primitive: Mapping[str, Any]
) -> MeshPart | None:
    attributes = primitive.get("attributes")
    if not isinstance(attributes, dict) or primitive.get("mode", _TRIANGLES) != _TRIANGLES:
        return None
    points = document.rows(attributes, "POSITION", "VEC3")
    if points is None:
        return None
    triangles = _triangles(document, primitive, len(points))
    moved = _influences(file, document, node, skin, attributes, len(points))
    if triangles is None or moved is None:
        return None
    bones, weights, matrices = moved
    positions = np.zeros((len(points), 3))
    turned = np.zeros((len(points), 3, 3))
    for place in range(weights.shape[1]):
        of_bone = matrices[:, place] * weights[:, place, None, None]
        positions += np.einsum("vij,vj->vi", of_bone[:, :3, :3], points) + of_bone[:, :3, 3]
        turned += of_bone[:, :3, :3]
    given = document.rows(attributes, "NORMAL", "VEC3")
    normals = _normals(positions, triangles) if given is None or len(given) != len(points) else given
    if given is not None and len(given) == len(points):
        normals = np.einsum("vij,vj->vi", turned, given)
    lengths = np.linalg.norm(normals, axis=-1, keepdims=True)
    uv = document.rows(attributes, "TEXCOORD_0", "VEC2")
    return MeshPart(
        file.rig.names[node],
        read_only(positions),
        read_only(normals / np.where(lengths > 0.0, lengths, 1.0)),
        None if uv is None or len(uv) != len(points) else read_only(np.asarray(uv, float)),
        read_only(triangles),
        read_only(bones),
        read_only(weights),
        _rgb(document, primitive),
    )


def _triangles(
    document: GltfDocument, primitive: Mapping[str, Any], num_vertices: int
) -> Int[np.ndarray, "triangles 3"] | None:
    if "indices" in primitive:
        rows = document.rows(primitive, "indices", "SCALAR")
        if rows is None:
            return None
        numbers = np.asarray(rows, np.int64).reshape(-1)
    else:
        numbers = np.arange(num_vertices)
    numbers = numbers[: len(numbers) - len(numbers) % 3]
    document.require(not len(numbers) or numbers.max() < num_vertices, "A mesh has triangles of vertices it lacks.")
    return numbers.reshape(-1, 3)


def _influences(
    file: CharacterFile,
    document: GltfDocument,
    node: int,
    skin: int | None,
    attributes: Mapping[str, Any],
    num_vertices: int,
) -> (
    tuple[
        Int[np.ndarray, "vertices influences"],
        Float[np.ndarray, "vertices influences"],
        Float[np.ndarray, "vertices influences 4 4"],
    ]
    | None
):
    """Nodes that move each vertex, their weights, and the matrices from the mesh to the scene."""
    if skin is None:
        matrices = np.broadcast_to(file.rig.worlds[node], (num_vertices, 1, 4, 4))
        bone = next((above for above in file.rig.ancestors(node) if file.rig.is_bone[above]), None)
        if bone is None:
            return None
        return np.full((num_vertices, 1), bone), np.ones((num_vertices, 1)), matrices
    joints = np.array(document.joints_of[skin])
    places, weights = (document.rows(attributes, name, "VEC4") for name in ("JOINTS_0", "WEIGHTS_0"))
    if places is None or weights is None:
        return None
    document.require(len(places) == len(weights) == num_vertices, "A mesh has attributes of different lengths.")
    numbers, shares = np.asarray(places, np.int64), np.maximum(np.asarray(weights, float), 0.0)
    document.require(
        not num_vertices or numbers.max() < len(joints), "A mesh names a bone that its skin does not have."
    )
    total = shares.sum(1, keepdims=True)
    shares = np.where(total > 0.0, shares / np.where(total > 0.0, total, 1.0), np.eye(1, _INFLUENCES))
    scene_from_mesh = file.rig.worlds[joints] @ document.bind_matrices(skin)
    return joints[numbers], shares, scene_from_mesh[numbers]


def _normals(
    positions: Float[np.ndarray, "vertices 3"], triangles: Int[np.ndarray, "triangles 3"]
) -> Float[np.ndarray, "vertices 3"]:
    first, second, third = positions[triangles].swapaxes(0, 1)
    of_triangles = np.cross(second - first, third - first)
    normals = np.zeros_like(positions)
    for corner in range(3):
        np.add.at(normals, triangles[:, corner], of_triangles)
    return normals


def _rgb(document: GltfDocument, primitive: Mapping[str, Any]) -> tuple[int, int, int]:
    """Colour of a part's material, from linear light."""
    number: Any = primitive.get("material")
    if not isinstance(number, int) or not 0 <= number < len(document.materials):
        return _PLAIN_RGB
    surface = document.materials[number].get("pbrMetallicRoughness")
    factor: Sequence[Any] | None = surface.get("baseColorFactor") if isinstance(surface, dict) else None
    if not isinstance(factor, list) or not all(isinstance(value, (int, float)) for value in factor[:3]):
        return (255, 255, 255)
    red, green, blue, *_ = (
        round(255 * min(max(float(value), 0.0), 1.0) ** (1 / _GAMMA)) for value in [*factor, 0, 0, 0]
    )
    return red, green, blue


_UNITS = 100.0
_SCALING = "Lcl Scaling"
# Order of the rotations that FBX has without a setting: about z, then y, then x of the bone.
_ORDER = "ZYX"


def encode(posed: PosedCharacter) -> Iterator[bytes]:
    """Write a character in motion as FBX, piece by piece. Equal motions give equal bytes."""
    motion, rig = posed.motion, posed.motion.figure.file.rig
    scene = FbxScene(motion.source.frame_rate_hz, _UNITS)
    name = _person_name(posed)
    clip = scene.add_clip(name, len(posed.frames))
    top = add_top(scene, motion.source, name, posed.origin_m, posed.frames.start)
    models: dict[int, Int64] = {}
    for node in _nodes(rig):
        above = models.get(int(rig.parents[node]), top)
        models[node] = _add_node(scene, rig, node, above)
    drawn = [_add_part(scene, rig, part, models) for part in mesh_parts(motion.figure.file)]
    at_rest = {models[node]: _file_from_node(rig, node) for node in models}
    scene.add_bind_pose(name, {top: np.eye(4), **at_rest, **{model: np.eye(4) for model in drawn}})
    if not posed.is_present.all():
        for model in drawn:
            scene.show(clip, model, posed.is_present)
    _animate(scene, clip, posed.held(), models)
    yield from write(scene.nodes)


def _person_name(posed: PosedCharacter) -> str:
    """Name of the person in the file, never a bone's name."""
    name = safe_name(posed.name) or "person"
    return f"{name} ({posed.motion.source.track_id})" if name in posed.motion.figure.rig.names else name


def _nodes(rig: CharacterRig) -> list[int]:
    """Bones and the nodes above them, parents first."""
    needed = {above for node in rig.bones for above in rig.ancestors(node)}
    return [node for node in rig.order if node in needed]


def _add_node(scene: FbxScene, rig: CharacterRig, node: int, above: Int64) -> Int64:
    kind, flag = ("LimbNode", "Skeleton") if rig.is_bone[node] else ("Null", "Null")
    at_rest = Rotation.from_quat(rig.rotations[node]).as_matrix()
    ((z_deg, y_deg, x_deg),) = euler_deg(at_rest[None, None], [_ORDER], np.zeros((1, 3)))[0]
    places = (
        local(TRANSLATION, rig.translations[node] * _UNITS),
        local(ROTATION, (x_deg, y_deg, z_deg)),
        vector(_SCALING, rig.scales[node], _SCALING, "", "A"),
    )
    name = safe_name(rig.names[node])
    model = scene.add_model(name, kind, above, *places)
    scene.connect(scene.add("NodeAttribute", name, "NodeAttribute", kind, Node("TypeFlags", (flag,))), model)
    return model


def _file_from_node(rig: CharacterRig, node: int) -> Float[np.ndarray, "4 4"]:
    transform = np.array(rig.worlds[node])
    transform[:3, 3] *= _UNITS
    return transform


def _add_part(scene: FbxScene, rig: CharacterRig, part: MeshPart, models: dict[int, Int64]) -> Int64:
    """Add a part of the mesh, bound to its bones; returns its model."""
    name = safe_name(part.name) or "mesh"
    uv = None if part.uv is None else part.uv * (1.0, -1.0) + (0.0, 1.0)
    drawn = add_mesh(scene, name, part.positions * _UNITS, np.array(part.triangles), part.normals, uv)
    scene.connect(add_material(scene, name, part.rgb), drawn.model)
    bound = []
    for node in np.unique(part.bones[part.weights > 0.0]).tolist():
        vertices, places = np.nonzero((part.bones == node) & (part.weights > 0.0))
        # A bone may be named twice at a vertex.
        numbers, at = np.unique(vertices, return_inverse=True)
        weights = np.bincount(at, part.weights[vertices, places])
        bound.append(BoundVertices(models[node], numbers, weights, _file_from_node(rig, node)))
    add_skin(scene, name, drawn, bound)
    return drawn.model


def _animate(scene: FbxScene, clip: Clip, held: PosedCharacter, models: dict[int, Int64]) -> None:
    """Add the curves of the place of each bone that shifts and of the rotation of each bone that turns."""
    for node in held.shifting():
        places = held.translations(node) * _UNITS
        scene.animate(clip, models[node], TRANSLATION, places[0], partial(_column, places))
    angles = _Angles(held)
    for place, node in enumerate(held.turning()):
        scene.animate(clip, models[node], ROTATION, angles.first[place], partial(angles.angles_deg, place))


def _column(values: Float[np.ndarray, "frames 3"], axis: int) -> Float[np.ndarray, " frames"]:
    return values[:, axis]


class _Angles:
    """Angles of all bones that turn about X, Y and Z in degrees, made when the first curve is written."""

    def __init__(self, held: PosedCharacter) -> None:
        self._held, self._nodes = held, held.turning()
        self.first: Float[np.ndarray, "bones 3"] = self._block(slice(0, 1), np.zeros((len(self._nodes), 3)))[0, :, ::-1]
        self._angles_deg: Float32[np.ndarray, "bones 3 frames"] | None = None

    def angles_deg(self, place: int, axis: int) -> Float32[np.ndarray, " frames"]:
        """Angles of a bone about an axis in all frames."""
        if self._angles_deg is None:
            num_frames, num_bones = len(self._held.frames), len(self._nodes)
            self._angles_deg = np.empty((num_bones, 3, num_frames), np.float32)
            before_deg = np.zeros((num_bones, 3))
            for rows in frame_blocks(num_frames):
                block_deg = self._block(rows, before_deg)
                before_deg = block_deg[-1]
                self._angles_deg[:, :, rows] = np.moveaxis(block_deg[..., ::-1], 0, -1)
        values: np.ndarray = self._angles_deg[place, axis]
        return values

    def _block(self, rows: slice, before_deg: Float[np.ndarray, "bones 3"]) -> Float[np.ndarray, "frames bones 3"]:
        """Angles in the order of the rotations in some frames, continuous with the frame before."""
        some = self._held.in_rows(rows)
        turns = np.stack([some.matrices(node) for node in self._nodes], axis=1)
        return euler_deg(turns, [_ORDER] * len(self._nodes), before_deg)


def read_xyz(path: Path, names: tuple[str, ...], units_per_m: float) -> Iterator[Float[np.ndarray, "_ bones 3"]]:
    """Read the places of bones from a file of ``encode``, block by block, in the person's world and metres.

    ``units_per_m`` is the scale of the person's path. Raises ``OSError`` if the file is damaged or lacks a bone.
    """
    try:
        stored = _StoredBones(StoredScene(read(np.memmap(path, np.uint8, "r").data)))
        for block in frame_blocks(stored.num_frames):
            places = stored.places(names, block)
            yield places / _UNITS @ Y_UP_FROM_WORLD / units_per_m + stored.origin_m
    except (FbxError, KeyError) as error:
        raise OSError(errno.EIO, f"{path.name} is damaged: {error}") from error


class _StoredBones:
    """Models of bones in a file, and their curves."""

    def __init__(self, scene: StoredScene) -> None:
        self._scene = scene
        limbs, nulls = scene.find_all("Model", "LimbNode"), scene.find_all("Model", "Null")
        self._models = {object_name(node): number for number, node in {**nulls, **limbs}.items()}
        top = next(iter(nulls.values()), None)
        if top is None:
            raise FbxError("there is no node at the top")
        self.origin_m = np.array(numbers(top, ORIGIN, 3) if has_setting(top, ORIGIN) else (0.0, 0.0, 0.0))
        self._layer = next(iter(scene.find_all("AnimationLayer", "")), 0)
        self._curves = {
            (number, kind): curves[1]
            for number in self._models.values()
            for kind in (TRANSLATION, ROTATION)
            if (curves := scene.curves(self._layer, number, kind)) is not None
        }
        self.num_frames = max((len(values[0]) for values in self._curves.values()), default=0)
        self._order = self._parents_first()
        self._place_of = {model: place for place, model in enumerate(self._order)}
        self._parents = [self._place_of.get(self._above(model), -1) for model in self._order]
        self._offsets, angles_deg, self._scales = (
            np.array([self._at_rest(model, kind, usual) for model in self._order])
            for kind, usual in ((TRANSLATION, 0.0), (ROTATION, 0.0), (_SCALING, 1.0))
        )
        self._turns = list(turned(angles_deg[:, ::-1], _ORDER) * self._scales[:, None])

    def _above(self, model: int) -> int:
        parent = self._scene.parent(model, "Model")
        return int(SCENE) if parent is None else parent

    def _parents_first(self) -> list[int]:
        """Numbers of the models of bones and of nodes above them."""
        order: dict[int, None] = {}
        for model in self._models.values():
            way = [model]
            while (above := self._above(way[-1])) != SCENE and above not in order:
                way.append(above)
            order |= dict.fromkeys(reversed(way))
        return list(order)

    def places(self, names: tuple[str, ...], block: slice) -> Float[np.ndarray, "frames bones 3"]:
        """Places of bones in the file's axes and unit in a block of frames."""
        turning = [place for place, model in enumerate(self._order) if (model, ROTATION) in self._curves]
        angles_deg = np.stack([self._values(self._order[place], ROTATION, block) for place in turning])
        turns = turned(angles_deg[..., ::-1], _ORDER)
        moving = {place: turn * self._scales[place] for place, turn in zip(turning, turns, strict=True)}
        moved = {
            place: self._values(model, TRANSLATION, block)
            for place, model in enumerate(self._order)
            if (model, TRANSLATION) in self._curves
        }
        places = chained_places(self._parents, self._offsets, self._turns, moved, moving)
        wanted = [places[self._place_of[self._models[safe_name(name)]]] for name in names]
        return together(wanted, block.stop - block.start)

    def _values(self, model: int, kind: str, block: slice) -> Float[np.ndarray, "frames 3"]:
        return np.stack([curve[block] for curve in self._curves[model, kind]], axis=-1).astype(float)

    def _at_rest(self, model: int, kind: str, usual: float) -> tuple[float, ...]:
        node = self._scene.objects[model]
        return numbers(node, kind, 3) if has_setting(node, kind) else (usual,) * 3
