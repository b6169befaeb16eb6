"""A glTF document with its buffer, put together from nodes, a skin and meshes."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int, Shaped

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
