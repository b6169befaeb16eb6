"""Reader of characters in FBX files: binary FBX 7, read within bounds, as the glTF document that writers go on with.

The character gets the axes and the unit of GLB, Y up and metres. Bones keep their names and their axes. Meshes are
triangles in the rest pose, moved by up to four bones, with normals, places in pictures and the colours of their
materials. Pictures, morphs and animations are left out.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float, Int, Shaped

from pipeline.core.errors import printable
from pipeline.core.problems.session_codes import CHARACTER_BONES, CHARACTER_TOO_LARGE
from pipeline.export.character.fbx.content import EXPORT_AGAIN, FbxContent, is_invertible
from pipeline.export.character.fbx.placement import ModelTree, bind, file_axes
from pipeline.export.character.gltf_reader import CharacterFile, build_character, decomposed
from pipeline.export.character.rig import MAX_COORDINATE, MAX_NODES, CharacterFileError, checked
from pipeline.export.writers.fbx_nodes import FbxError, Node
from pipeline.export.writers.fbx_stored import object_name

Rgb = tuple[float, float, float]
"""Colour in linear light, 0 to 1."""

_ALIGNMENT = 4
_COMPONENTS = {"<f4": 5126, "<u2": 5123, "<u4": 5125}
# Targets of views: attributes of vertices, and indices of triangles.
_ATTRIBUTES, _INDICES = 34962, 34963
_ROUGHNESS = 0.8


@dataclass(frozen=True, slots=True, eq=False)
class Primitive:
    """Triangles with one material."""

    positions: Float[np.ndarray, "vertices 3"]
    normals: Float[np.ndarray, "vertices 3"] | None
    uv: Float[np.ndarray, "vertices 2"] | None  # From the upper left corner of the picture
    # Places of bones in the skin, and their weights; ``None``: no bone moves the mesh
    joints: Int[np.ndarray, "vertices 4"] | None
    weights: Float[np.ndarray, "vertices 4"] | None
    triangles: Int[np.ndarray, "triangles 3"]
    rgb: Rgb
    material: str  # Name of the material


class GltfBuilder:
    """Document that grows; nodes, once they are added, keep their numbers."""

    def __init__(self) -> None:
        self._nodes: list[dict[str, Any]] = []
        self._tops: list[int] = []
        self._meshes: list[dict[str, Any]] = []
        self._materials: dict[tuple[str, Rgb], int] = {}
        self._skins: list[dict[str, Any]] = []
        self._views: list[dict[str, Any]] = []
        self._accessors: list[dict[str, Any]] = []
        self._pieces: list[bytes] = []
        self._num_bytes = 0

    def add_node(self, name: str, parent: int | None, **content: Any) -> int:
        """Add a node below another one; returns its number."""
        number = len(self._nodes)
        self._nodes.append({"name": name, **content})
        if parent is None:
            self._tops.append(number)
        else:
            self._nodes[parent].setdefault("children", []).append(number)
        return number

    def add_skin(self, joints: Sequence[int], joint_from_scene: Float[np.ndarray, "joints 4 4"]) -> None:
        """Add the skin of all meshes that bones move; ``joints`` are numbers of nodes."""
        matrices = self._accessor("MAT4", joint_from_scene.swapaxes(1, 2).reshape(-1, 16).astype("<f4"))
        self._skins.append({"joints": list(joints), "inverseBindMatrices": matrices})

    def add_mesh(self, name: str, primitives: Iterable[Primitive]) -> None:
        """Add a mesh below no node, with the skin if bones move it."""
        parts = [self._primitive(primitive) for primitive in primitives]
        skin = {"skin": 0} if "JOINTS_0" in parts[0]["attributes"] else {}
        self.add_node(name, None, mesh=len(self._meshes), **skin)
        self._meshes.append({"name": name, "primitives": parts})

    def _primitive(self, primitive: Primitive) -> dict[str, Any]:
        positions = primitive.positions.astype("<f4")
        bounds = {"min": positions.min(0).tolist(), "max": positions.max(0).tolist()}
        attributes = {"POSITION": self._accessor("VEC3", positions, **bounds)}
        if primitive.normals is not None:
            attributes["NORMAL"] = self._accessor("VEC3", primitive.normals.astype("<f4"))
        if primitive.uv is not None:
            attributes["TEXCOORD_0"] = self._accessor("VEC2", primitive.uv.astype("<f4"))
        if primitive.joints is not None and primitive.weights is not None:
            attributes["JOINTS_0"] = self._accessor("VEC4", primitive.joints.astype("<u2"))
            attributes["WEIGHTS_0"] = self._accessor("VEC4", primitive.weights.astype("<f4"))
        material = self._materials.setdefault((primitive.material, primitive.rgb), len(self._materials))
        indices = self._accessor("SCALAR", primitive.triangles.reshape(-1, 1).astype("<u4"))
        return {"attributes": attributes, "indices": indices, "material": material}

    def _accessor(self, kind: str, rows: Shaped[np.ndarray, "rows columns"], **bounds: list[float]) -> int:
        content = np.ascontiguousarray(rows).tobytes()
        use = {} if kind == "MAT4" else {"target": _INDICES if kind == "SCALAR" else _ATTRIBUTES}
        self._views.append({"buffer": 0, "byteOffset": self._num_bytes, "byteLength": len(content), **use})
        padded = content + bytes(-len(content) % _ALIGNMENT)
        self._pieces.append(padded)
        self._num_bytes += len(padded)
        component = _COMPONENTS[rows.dtype.newbyteorder("<").str]
        self._accessors.append(
            {
                "bufferView": len(self._views) - 1,
                "componentType": component,
                "count": len(rows),
                "type": kind,
                **bounds,
            }
        )
        return len(self._accessors) - 1

    def document(self) -> tuple[dict[str, Any], memoryview]:
        """Document and its buffer."""
        document: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": "Multicap"},
            "scene": 0,
            "scenes": [{"nodes": self._tops}],
            "nodes": self._nodes,
        }
        parts = {
            "meshes": self._meshes,
            "materials": [_material(name, rgb) for name, rgb in self._materials],
            "skins": self._skins,
            "buffers": [{"byteLength": self._num_bytes}] if self._num_bytes else [],
            "bufferViews": self._views,
            "accessors": self._accessors,
        }
        # Lists must not be empty.
        return document | {name: values for name, values in parts.items() if values}, memoryview(b"".join(self._pieces))


def _material(name: str, rgb: Rgb) -> dict[str, Any]:
    surface = {"baseColorFactor": [*rgb, 1.0], "metallicFactor": 0.0, "roughnessFactor": _ROUGHNESS}
    return {"name": name, "pbrMetallicRoughness": surface}


MAX_POINTS, MAX_CORNERS = 4_000_000, 12_000_000
"""Largest numbers of points, and of corners of polygons, of all surfaces."""


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """Surface in the axes of its geometry. Corners of polygons are in the file's order."""

    points: Float[np.ndarray, "points 3"]
    corners: Int[np.ndarray, " corners"]  # Point of each corner
    triangles: Int[np.ndarray, "triangles 3"]  # Corners
    materials: Int[np.ndarray, " triangles"]  # Place of each triangle's material among the model's materials
    normals: Float[np.ndarray, "corners 3"] | None
    uv: Float[np.ndarray, "corners 2"] | None  # From the lower left corner of the picture

    def placed(self, scene_from_point: Float[np.ndarray, "points 3 4"]) -> "Surface":
        """Surface with its points moved by matrices; normals have the length 1, mirrored triangles turn around."""
        turned = scene_from_point[..., :3]
        points = np.einsum("vij,vj->vi", turned, self.points) + scene_from_point[..., 3]
        first, second, third = (turned[..., column] for column in range(3))
        # Cofactors turn normals: they are the inverse, transposed, times the determinant.
        cofactors = np.stack([np.cross(second, third), np.cross(third, first), np.cross(first, second)], axis=-1)
        is_mirrored = np.einsum("vi,vi->v", first, cofactors[..., 0])[self.corners] < 0.0
        triangles = np.where(is_mirrored[self.triangles[:, :1]], self.triangles[:, ::-1], self.triangles)
        normals = None
        if self.normals is not None:
            normals = np.einsum("cij,cj->ci", cofactors[self.corners], self.normals)
            normals = _unit(normals * np.where(is_mirrored, -1.0, 1.0)[:, None])
        return replace(self, points=points, triangles=triangles, normals=normals)


@dataclass(frozen=True, slots=True, eq=False)
class _Polygons:
    """Corners of polygons."""

    points: Int[np.ndarray, " corners"]  # Point of each corner
    starts: Int[np.ndarray, " polygons"]  # First corner of each polygon
    sizes: Int[np.ndarray, " polygons"]  # Number of its corners

    def triangles(self) -> tuple[Int[np.ndarray, "triangles 3"], Int[np.ndarray, " triangles"]]:
        """Triangles from the first corner of each polygon, and the polygon of each."""
        counts = np.maximum(self.sizes - 2, 0)
        polygons = np.repeat(np.arange(len(counts)), counts)
        steps = np.arange(len(polygons)) - np.repeat(np.cumsum(counts) - counts, counts)
        first = self.starts[polygons]
        return np.column_stack([first, first + steps + 1, first + steps + 2]), polygons


def read_surface(content: FbxContent, geometry: Node, before: tuple[int, int]) -> Surface | None:
    """Read the surface of a geometry; ``None`` if it has no polygons.

    Normals and places in pictures that do not fit its corners are left out. ``before`` are the numbers of points
    and corners that were read before. Raises ``FbxError`` or ``CharacterFileError`` if the geometry is damaged, or has
    more of them than are read.
    """
    points, ends = content.reals(geometry, "Vertices", 3), content.integers(geometry, "PolygonVertexIndex")
    if points is None or ends is None:
        return None
    if before[0] + len(points) > MAX_POINTS or before[1] + len(ends) > MAX_CORNERS:
        message = f"The meshes of the file have more than {MAX_POINTS:,} vertices, or {MAX_CORNERS:,} corners."
        raise CharacterFileError(message, CHARACTER_TOO_LARGE, "Leave out what is not the character.")
    # The last corner of each polygon is marked by its sign.
    last = np.flatnonzero(ends < 0)
    if not len(last):
        return None
    ends = ends[: last[-1] + 1].astype(np.int64)
    starts = np.concatenate([[0], last[:-1] + 1])
    polygons = _Polygons(np.where(ends < 0, ~ends, ends), starts, last - starts + 1)
    if polygons.points.max() >= len(points):
        raise FbxError("a mesh has polygons of vertices that it lacks")
    triangles, of_triangles = polygons.triangles()
    if not len(triangles):
        return None
    return Surface(
        points,
        polygons.points,
        triangles,
        _materials(content, geometry, polygons)[of_triangles],
        _layer(content, geometry, polygons, "LayerElementNormal", "Normals", 3),
        _layer(content, geometry, polygons, "LayerElementUV", "UV", 2),
    )


def _layer(
    content: FbxContent, geometry: Node, polygons: _Polygons, kind: str, name: str, columns: int
) -> Float[np.ndarray, "corners columns"] | None:
    """Values of the first layer of a kind at each corner; ``None`` without one, or if they do not fit."""
    layer = geometry.child(kind)
    if layer is None:
        return None
    mapping, reference = (_text(layer, f"{word}InformationType") for word in ("Mapping", "Reference"))
    num_corners = len(polygons.points)
    match mapping:
        case "ByPolygonVertex":
            rows = np.arange(num_corners)
        case "ByVertice" | "ByVertex":
            rows = polygons.points
        case "ByPolygon":
            rows = np.repeat(np.arange(len(polygons.sizes)), polygons.sizes)
        case _:
            return None
    values = content.reals(layer, name, columns)
    places = None if reference == "Direct" else content.integers(layer, f"{name}Index")
    if places is not None:
        if rows.max() >= len(places):
            return None
        rows = places[rows].astype(np.int64)
    if values is None or rows.max() >= len(values):
        return None
    # Corners without a value have the number -1.
    return np.where(rows[:, None] < 0, 0.0, values[np.maximum(rows, 0)]) if len(values) else None


def _materials(content: FbxContent, geometry: Node, polygons: _Polygons) -> Int[np.ndarray, " polygons"]:
    """Place of each polygon's material; 0 where the file states none."""
    layer, places = geometry.child("LayerElementMaterial"), np.zeros(len(polygons.sizes), np.int64)
    stored = None if layer is None else content.integers(layer, "Materials")
    if layer is None or stored is None or not len(stored):
        return places
    if _text(layer, "MappingInformationType") == "ByPolygon":
        return np.maximum(stored.astype(np.int64), 0) if len(stored) == len(places) else places
    return places + max(int(stored[0]), 0)


def _unit(vectors: Float[np.ndarray, "rows 3"]) -> Float[np.ndarray, "rows 3"]:
    """Vectors of length 1; those without a direction point up."""
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.where(lengths > 0.0, vectors / np.where(lengths > 0.0, lengths, 1.0), (0.0, 1.0, 0.0))


def _text(node: Node, name: str) -> str:
    child = node.child(name)
    value = child.properties[0] if child is not None and child.properties else ""
    return value if isinstance(value, str) else ""


_GAMMA = 2.2
# Colour of materials with a picture, which is left out, and of meshes without a material, in linear light.
_PLAIN = (0.57, 0.57, 0.57)
_COLOR, _FACTOR, _USUAL_COLOR = "DiffuseColor", "DiffuseFactor", (0.8, 0.8, 0.8)


def decode_fbx_character(name: str, content: bytes) -> CharacterFile:
    """Read a character from the bytes of an FBX file.

    Raises ``InputError`` if the file is text or of an old version, is damaged, or has more than is read.
    """
    with checked(name), np.errstate(over="ignore", invalid="ignore"):
        try:
            document, binary = _Character(FbxContent(content)).document()
        except FbxError as error:
            raise CharacterFileError(f"The file is damaged: {printable(str(error))}.", hint=EXPORT_AGAIN) from error
        return build_character(name, document, binary, "FBX")


class _Character:
    """A character on its way from a file to a glTF document."""

    def __init__(self, content: FbxContent) -> None:
        self._content, self._tree = content, ModelTree(content)
        self._unit_m, axes = file_axes(content)
        self._scene_from_file = np.diag([0.0, 0.0, 0.0, 1.0])
        self._scene_from_file[:3, :3] = self._unit_m * axes
        self._builder = GltfBuilder()
        self._num_points = self._num_corners = self._num_primitives = 0

    def document(self) -> tuple[dict[str, Any], memoryview]:
        """Document with the bones and the nodes above them, and meshes; without bones it has all models as nodes."""
        tree = self._tree
        kept = {above for bone in tree.bones for above in tree.ancestors(bone)} or set(tree.models)
        nodes = self._add_nodes([number for number in tree.order if number in kept])
        bones = [number for number in tree.order if number in tree.bones]
        if bones:
            worlds = np.array([self._world(number) for number in bones])
            self._builder.add_skin([nodes[number] for number in bones], np.linalg.inv(worlds))
        joints = {number: place for place, number in enumerate(bones)}
        taken = {object_name(tree.models[number]) for number in kept}
        for model in tree.order:
            for geometry in dict.fromkeys(self._content.scene.children(model, "Geometry")):
                before = self._num_points, self._num_corners
                surface = read_surface(self._content, self._content.scene.objects[geometry], before)
                if surface is not None:
                    self._num_points += len(surface.points)
                    self._num_corners += len(surface.corners)
                    name = object_name(tree.models[model]) or "mesh"
                    primitives = self._primitives(model, geometry, surface, joints)
                    self._builder.add_mesh(f"{name} mesh" if name in taken else name, primitives)
        return self._builder.document()

    def _world(self, number: int) -> Float[np.ndarray, "4 4"]:
        """Matrix from a model to the scene in the rest pose: places in metres, scales as the file has them."""
        world = self._scene_from_file @ self._tree.worlds[number]
        world[:3, :3] /= self._unit_m
        return np.asarray(world)

    def _add_nodes(self, numbers: list[int]) -> dict[int, int]:
        """Add nodes at rest; returns the number of each model's node."""
        nodes: dict[int, int] = {}
        for number in numbers:
            name, parent = object_name(self._tree.models[number]), self._tree.parents[number]
            above, world = np.eye(4) if parent is None else self._world(parent), self._world(number)
            place = decomposed(np.linalg.inv(above) @ world) if is_invertible(world) else None
            if place is None:
                message = f"The node {printable(name)} is sheared, or has no size."
                raise CharacterFileError(message, CHARACTER_BONES, "Apply the scales of the nodes before the export.")
            settings = zip(("translation", "rotation", "scale"), (part.tolist() for part in place), strict=True)
            nodes[number] = self._builder.add_node(name, None if parent is None else nodes[parent], **dict(settings))
        return nodes

    def _primitives(
        self, model: int, geometry: int, surface: Surface, joints: Mapping[int, int]
    ) -> Iterator[Primitive]:
        num_points = len(surface.points)
        bound = bind(self._content, self._tree, model, geometry, num_points, self._scene_from_file)
        if bound is None:
            world = self._scene_from_file @ self._tree.worlds[model] @ self._tree.geometric(model)
            placed = surface.placed(np.broadcast_to(world[:3], (num_points, 3, 4)))
            joints_of = None
        else:
            placed = surface.placed(bound.matrices)
            bones, at = np.unique(bound.bones, return_inverse=True)
            joints_of = np.array([joints[bone] for bone in bones.tolist()])[at].reshape(bound.bones.shape)
        if not (np.abs(placed.points) < MAX_COORDINATE).all():
            raise CharacterFileError("A mesh has positions that are not numbers, or too large.", hint=EXPORT_AGAIN)
        uv = None if placed.uv is None else placed.uv * (1.0, -1.0) + (0.0, 1.0)
        materials = list(self._content.scene.children(model, "Material"))
        numbers = np.minimum(placed.materials, len(materials))
        for number in np.unique(numbers).tolist():
            self._count_primitive()
            of_material = numbers == number
            part = replace(
                placed, triangles=placed.triangles[of_material], materials=placed.materials[of_material], uv=uv
            )
            points, corners, triangles = merged(part)
            rgb, material = self._material(materials[number] if number < len(materials) else None)
            yield Primitive(
                placed.points[points],
                None if placed.normals is None else placed.normals[corners],
                None if uv is None else uv[corners],
                None if joints_of is None else joints_of[points],
                None if bound is None else bound.weights[points],
                triangles,
                rgb,
                material,
            )

    def _count_primitive(self) -> None:
        self._num_primitives += 1
        if self._num_primitives > MAX_NODES:
            message = f"The file has more than {MAX_NODES:,} meshes, counted by material."
            raise CharacterFileError(message, CHARACTER_TOO_LARGE, "Leave out what is not the character.")

    def _material(self, number: int | None) -> tuple[Rgb, str]:
        """Colour in linear light of a material, and its name."""
        if number is None:
            return _PLAIN, "plain"
        content, node = self._content, self._content.scene.objects[number]
        if any(next(content.scene.children(number, kind, _COLOR), None) for kind in ("Texture", "LayeredTexture")):
            return _PLAIN, object_name(node)
        color = content.vector(node, _COLOR, _USUAL_COLOR) * content.number(node, _FACTOR, 1.0)
        red, green, blue = (np.clip(color, 0.0, 1.0) ** _GAMMA).tolist()
        return (red, green, blue), object_name(node)


def merged(
    surface: Surface,
) -> tuple[Int[np.ndarray, " vertices"], Int[np.ndarray, " vertices"], Int[np.ndarray, "triangles 3"]]:
    """Vertices of a surface's triangles, equal corners being one: point and first corner of each, and the triangles."""
    corners = surface.triangles.reshape(-1)
    _, keys = np.unique(surface.corners[corners], return_inverse=True)
    for values in (surface.normals, surface.uv):
        for column in () if values is None else values[corners].astype("<f4").T:
            steps = np.unique(column, return_inverse=True)[1]
            _, keys = np.unique(keys * (steps.max() + 1) + steps, return_inverse=True)
    _, first = np.unique(keys, return_index=True)
    return surface.corners[corners[first]], corners[first], keys.reshape(-1, 3)
