"""Reader of characters in FBX files: binary FBX 7, read within bounds, as the glTF document that writers go on with.

The character gets the axes and the unit of GLB, Y up and metres. Bones keep their names and their axes. Meshes are
triangles in the rest pose, moved by up to four bones, with normals, places in pictures and the colours of their
materials. Pictures, morphs and animations are left out.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from pipeline.core.errors import printable
from pipeline.core.problems.sessions import CHARACTER_BONES, CHARACTER_TOO_LARGE
from pipeline.export.character.fbx.content import EXPORT_AGAIN, FbxContent, is_invertible
from pipeline.export.character.fbx.gltf_document import GltfBuilder, Primitive, Rgb
from pipeline.export.character.fbx.placement import ModelTree, axes_of
from pipeline.export.character.fbx.skins import bind
from pipeline.export.character.fbx.surface import Surface, surface_of
from pipeline.export.character.gltf_reader import CharacterFile, character_of, decomposed
from pipeline.export.character.problems import MAX_COORDINATE, MAX_NODES, CharacterFileError, checked
from pipeline.export.writers.fbx_nodes import FbxError
from pipeline.export.writers.fbx_stored import name_of

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
        return character_of(name, document, binary, "FBX")


class _Character:
    """A character on its way from a file to a glTF document."""

    def __init__(self, content: FbxContent) -> None:
        self._content, self._tree = content, ModelTree(content)
        self._unit_m, axes = axes_of(content)
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
        taken = {name_of(tree.models[number]) for number in kept}
        for model in tree.order:
            for geometry in dict.fromkeys(self._content.scene.children(model, "Geometry")):
                before = self._num_points, self._num_corners
                surface = surface_of(self._content, self._content.scene.objects[geometry], before)
                if surface is not None:
                    self._num_points += len(surface.points)
                    self._num_corners += len(surface.corners)
                    name = name_of(tree.models[model]) or "mesh"
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
            name, parent = name_of(self._tree.models[number]), self._tree.parents[number]
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
        """Parts of a mesh with one material each."""
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
            raise CharacterFileError("A mesh has positions that are no numbers, or too large.", hint=EXPORT_AGAIN)
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
            return _PLAIN, name_of(node)
        color = content.vector(node, _COLOR, _USUAL_COLOR) * content.number(node, _FACTOR, 1.0)
        red, green, blue = (np.clip(color, 0.0, 1.0) ** _GAMMA).tolist()
        return (red, green, blue), name_of(node)


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
