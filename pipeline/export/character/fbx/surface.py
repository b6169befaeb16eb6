"""Surfaces of an FBX file: polygons as triangles, with normals and places in pictures at their corners."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from pipeline.core.problems.sessions import CHARACTER_TOO_LARGE
from pipeline.export.character.fbx.content import FbxContent
from pipeline.export.character.problems import CharacterFileError
from pipeline.export.writers.fbx_nodes import FbxError, Node

MAX_POINTS, MAX_CORNERS = 4_000_000, 12_000_000
"""Largest numbers of points, and of corners of polygons, of all surfaces."""


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """Surface in the axes of its geometry. Corners are those of polygons, in the file's order."""

    points: Float[np.ndarray, "points 3"]
    corners: Int[np.ndarray, " corners"]  # Point of each corner
    triangles: Int[np.ndarray, "triangles 3"]  # Corners
    materials: Int[np.ndarray, " triangles"]  # Place of each triangle's material among those of the model
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


def surface_of(content: FbxContent, geometry: Node, before: tuple[int, int]) -> Surface | None:
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
