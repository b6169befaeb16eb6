"""Meshes of a character in its rest pose, with the bones that move them, for formats other than the character's own."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from pipeline.core.data.arrays import read_only
from pipeline.export.character.gltf_reader import CharacterFile, GltfDocument, objects_in
from pipeline.export.character.rig import checked

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
