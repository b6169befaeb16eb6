"""FBX of characters for tests: the rigs of ``character.characters`` as other programs store them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from pipeline.export.character.gltf_reader import CharacterFile
from pipeline.export.character.writers.character_fbx import MeshPart, mesh_parts
from pipeline.export.writers.euler import euler_deg
from pipeline.export.writers.fbx_drawn import BoundVertices, add_material, add_mesh, add_skin
from pipeline.export.writers.fbx_nodes import Int64, Node, Property, array, read, write
from pipeline.export.writers.fbx_scene import (
    ROTATION,
    SETTINGS,
    TRANSLATION,
    FbxScene,
    integer,
    local,
    settings,
    vector,
)

Settings = Callable[[str, np.ndarray], Sequence[Node]]
"""Settings of a model by its name and the matrix from it to its parent."""

Z_UP = {"UpAxis": 2, "FrontAxis": 1, "FrontAxisSign": -1, "CoordAxis": 0}
"""Axes of a file with Z up that faces -Y, as Blender, 3ds Max and Unreal have them."""


def plain(_: str, matrix: np.ndarray) -> Sequence[Node]:
    """Settings as Blender writes them: translation, rotation, scales."""
    scales = np.linalg.norm(matrix[:3, :3], axis=0)
    return (
        local(TRANSLATION, matrix[:3, 3]),
        local(ROTATION, euler(matrix[:3, :3] / scales)),
        vector("Lcl Scaling", scales, "Lcl Scaling", "", "A"),
    )


def oriented(_: str, matrix: np.ndarray) -> Sequence[Node]:
    """Settings as Maya writes them: joints do not turn at rest, their orientation is the pre-rotation."""
    scales = np.linalg.norm(matrix[:3, :3], axis=0)
    return (
        local(TRANSLATION, matrix[:3, 3]),
        integer("RotationActive", 1),
        vector("PreRotation", euler(matrix[:3, :3] / scales)),
        vector("Lcl Scaling", scales, "Lcl Scaling", "", "A"),
    )


def euler(turn: np.ndarray) -> np.ndarray:
    """Angles about x, y and z in degrees, in this order."""
    return np.asarray(euler_deg(turn[None, None], ["ZYX"], np.zeros((1, 3)))[0, 0, ::-1])


def fbx_of(
    file: CharacterFile,
    *,
    settings_of: Settings = plain,
    file_from_rig: np.ndarray | None = None,
    axes: Mapping[str, float] | None = None,
    unit_cm: float = 1.0,
    has_skin: bool = True,
    change: Callable[[MeshPart], MeshPart] = lambda part: part,
) -> bytes:
    """FBX of a character at rest, with its mesh.

    Parameters
    ----------
    file_from_rig
        Matrix (4, 4) from the rig's axes and unit to those of the file.
    axes
        Settings of the file's axes; by default Y is up.
    has_skin
        Whether the mesh is bound to the bones; without it there is only the skeleton.
    change
        Changes a part of the mesh before it is written.
    """
    rig, scene = file.rig, FbxScene(30.0, 100.0 / unit_cm)
    moved = np.eye(4) if file_from_rig is None else file_from_rig
    length = np.linalg.norm(moved[:3, 0])
    worlds = moved @ rig.worlds
    worlds[:, :3, :3] /= length
    needed = {above for node in rig.bones for above in rig.ancestors(node)}
    models: dict[int, Int64] = {}
    for node in (node for node in rig.order if node in needed):
        parent = int(rig.parents[node])
        above = np.eye(4) if parent < 0 else worlds[parent]
        kind = "LimbNode" if rig.is_bone[node] else "Null"
        places = settings_of(rig.names[node], np.linalg.inv(above) @ worlds[node])
        models[node] = scene.add_model(rig.names[node], kind, models.get(parent, Int64(0)), *places)
    for part in map(change, mesh_parts(file)) if has_skin else ():
        positions = part.positions @ moved[:3, :3].T + moved[:3, 3]
        normals = part.normals @ moved[:3, :3].T / length
        uv = None if part.uv is None else part.uv * (1.0, -1.0) + (0.0, 1.0)
        drawn = add_mesh(scene, part.name, positions, np.array(part.triangles), normals, uv)
        scene.connect(add_material(scene, "Skin", part.rgb), drawn.model)
        bound = []
        for node in np.unique(part.bones[part.weights > 0.0]).tolist():
            vertices, at = np.nonzero((part.bones == node) & (part.weights > 0.0))
            bound.append(BoundVertices(models[node], vertices, part.weights[vertices, at], worlds[node]))
        add_skin(scene, part.name, drawn, bound)
    return b"".join(write(lambda version: [_changed(node, axes or {}) for node in scene.nodes(version)]))


def _changed(node: Node, axes: Mapping[str, float]) -> Node:
    """Top node of a file with other axes."""
    if node.name != "GlobalSettings":
        return node
    stored = node.child(SETTINGS)
    assert stored is not None
    kept = [setting for setting in stored.children if setting.properties[0] not in axes]
    changed = settings(*kept, *(integer(name, int(value)) for name, value in axes.items()))
    return replace(node, children=(*(child for child in node.children if child.name != SETTINGS), changed))


def skeleton_of(models: Sequence[tuple[str, Sequence[Node]]]) -> bytes:
    """FBX of a chain of bones without a mesh, each with its settings, and a take of two frames in which it is still."""
    scene = FbxScene(30.0, 100.0)
    clip, above = scene.add_clip("still", 2), Int64(0)
    for name, places in models:
        above = scene.add_model(name, "LimbNode", above, *places)
        scene.connect(
            scene.add("NodeAttribute", name, "NodeAttribute", "LimbNode", Node("TypeFlags", ("Skeleton",))), above
        )
        at_rest = next(node.properties[4:] for node in places if node.properties[0] == ROTATION)
        scene.animate(clip, above, ROTATION, np.array(at_rest), lambda axis, at_rest=at_rest: np.full(2, at_rest[axis]))  # type: ignore[misc]
    return b"".join(write(scene.nodes))


def mutated_fbx(content: bytes, number: int, rng: np.random.Generator) -> bytes:
    """File with damaged bytes, cut off, or with a few other values in its nodes."""
    if number % 2:
        stored = read(content)
        share = 2.0 / sum(map(_num_nodes, stored))
        nodes = [_mutated(node, rng, share) for node in stored]
        return b"".join(write(lambda _: nodes))
    damaged = bytearray(content)
    for _ in range(1 + number % 3):
        damaged[int(rng.integers(0, len(damaged)))] = int(rng.integers(0, 256))
    return bytes(damaged[: int(rng.integers(1, len(damaged)))] if number % 10 == 0 else damaged)


def _num_nodes(node: Node) -> int:
    return 1 + sum(map(_num_nodes, node.children))


def _mutated(node: Node, rng: np.random.Generator, share: float) -> Node:
    """Node of which some values and children are something else."""
    children = [_mutated(child, rng, share) for child in node.children if rng.random() > share / 2.0]
    properties = list(node.properties)
    if properties and rng.random() < share:
        others: list[Property] = [0, -1, 2**31 - 1, Int64(2**63 - 1), 1e308, float("nan"), "x", b"", True]
        others += [array("i", [0, 5, ~9]), array("d", [1e300] * 16), array("d", np.zeros(16)), array("l", [])]
        properties[int(rng.integers(len(properties)))] = others[int(rng.integers(len(others)))]
    return replace(node, properties=tuple(properties), children=tuple(children))
