"""Content of a stranger's FBX file: objects, their settings and arrays, each checked and within bounds."""

from collections.abc import Mapping
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from pipeline.core.problems.session_codes import CHARACTER_FORMAT, CHARACTER_TOO_LARGE
from pipeline.export.character.rig import MAX_COORDINATE, MIN_SCALE, CharacterFileError
from pipeline.export.writers.fbx_nodes import ArrayProperty, FbxError, Node, read
from pipeline.export.writers.fbx_scene import SETTINGS
from pipeline.export.writers.fbx_stored import StoredScene, has_setting, numbers

EXPORT_AGAIN = "Export the character once more, as binary FBX 2014 or later, or as GLB."
"""Hint of files that can't be read."""

_BINARY, _TEXT = b"Kaydara FBX Binary", b"; FBX"
# Place and size of the version, the oldest and newest versions that are read, and a number that is no version.
_VERSION_AT, _VERSION_BYTES, _OLDEST, _NEWEST, _UNKNOWN = 23, 4, 7000, 7999, 10_000
# Arrays are compressed, and may be read more than once: few bytes of a file may be many numbers. Small ones count too.
_MAX_BYTES_OF_ARRAYS, _BYTES_OF_ONE = 1 << 30, 1 << 10
_MATRIX = 16


def is_fbx(content: bytes) -> bool:
    """True if a file is FBX, binary or text."""
    return content.startswith((_BINARY, _TEXT))


class FbxContent:
    """Objects of a file. Methods raise ``CharacterFileError`` or ``FbxError`` if an object is damaged."""

    def __init__(self, content: bytes) -> None:
        _require_version(content)
        nodes = read(content)
        self.scene = StoredScene(nodes)
        self._templates = _templates(nodes)
        self._num_bytes = 0

    def vector(self, node: Node, name: str, usual: tuple[float, float, float]) -> Float[np.ndarray, " 3"]:
        """Setting of an object with three numbers: its own, its kind's, or the usual one."""
        owner = self._owner(node, name)
        xyz = np.array(usual if owner is None else numbers(owner, name, 3))
        if np.abs(xyz).max() > MAX_COORDINATE:
            raise CharacterFileError("An object is too far away, or too large.", hint=EXPORT_AGAIN)
        return xyz

    def number(self, node: Node, name: str, usual: float) -> float:
        """Setting of an object with a number: its own, its kind's, or the usual one."""
        owner = self._owner(node, name)
        return usual if owner is None else numbers(owner, name, 1)[0]

    def integers(self, node: Node, name: str) -> Int[np.ndarray, " numbers"] | None:
        """Integers of an object; ``None`` without them."""
        return self._array(node, name, "il")

    def reals(self, node: Node, name: str, columns: int = 1) -> Float[np.ndarray, "rows columns"] | None:
        """Rows of finite numbers of an object; ``None`` without them."""
        values = self._array(node, name, "fd")
        if values is None:
            return None
        if len(values) % columns or not (np.abs(values) <= MAX_COORDINATE).all():
            raise FbxError(f"{name} has other numbers than it states")
        return values.reshape(-1, columns).astype(float)

    def matrix(self, node: Node, name: str) -> Float[np.ndarray, "4 4"] | None:
        """Matrix of an object; ``None`` without one, or if it has no inverse."""
        values = self.reals(node, name, _MATRIX)
        if values is None or len(values) != 1:
            return None
        matrix = values.reshape(4, 4).T
        return matrix if is_invertible(matrix) else None

    def _owner(self, node: Node, name: str) -> Node | None:
        """Node that states a setting: the object, or the template of its kind; ``None`` without one."""
        return node if has_setting(node, name) else self._templates.get((node.name, name))

    def _array(self, node: Node, name: str, codes: Literal["il", "fd"]) -> np.ndarray | None:
        child = node.child(name)
        if child is None or not child.properties:
            return None
        stored = child.properties[0]
        if not isinstance(stored, ArrayProperty) or stored.code not in codes:
            raise FbxError(f"{name} is not an array of numbers")
        values = stored.values()
        self._num_bytes += values.nbytes + _BYTES_OF_ONE
        if self._num_bytes > _MAX_BYTES_OF_ARRAYS:
            message = f"The meshes of the file have more than {_MAX_BYTES_OF_ARRAYS >> 20} MiB of numbers."
            raise CharacterFileError(message, CHARACTER_TOO_LARGE, "Leave out what is not the character.")
        return values


def is_invertible(matrix: Float[np.ndarray, "4 4"]) -> bool:
    """True if a transform has an inverse."""
    scales = np.linalg.norm(matrix[:3, :3], axis=0)
    is_sized = ((scales > MIN_SCALE) & (scales < MAX_COORDINATE)).all()
    return bool(is_sized and abs(np.linalg.det(matrix[:3, :3] / scales)) > MIN_SCALE)


def _require_version(content: bytes) -> None:
    if content.startswith(_TEXT):
        message = "The FBX file is text; binary FBX is read."
        raise CharacterFileError(message, CHARACTER_FORMAT, EXPORT_AGAIN)
    version = int.from_bytes(content[_VERSION_AT : _VERSION_AT + _VERSION_BYTES], "little")
    if len(content) >= _VERSION_AT + _VERSION_BYTES and not _OLDEST <= version <= _NEWEST:
        named = f"FBX {version / 1000:.1f}" if version < _UNKNOWN else "of an unknown version of FBX"
        raise CharacterFileError(f"The file is {named}; FBX 7.0 to 7.9 are read.", CHARACTER_FORMAT, EXPORT_AGAIN)


def _templates(nodes: tuple[Node, ...]) -> Mapping[tuple[str, str], Node]:
    """Settings by kind of objects and name, which hold where an object states none; each in a node as objects are."""
    found: dict[tuple[str, str], Node] = {}
    definitions = next((node for node in nodes if node.name == "Definitions"), Node(""))
    for kind in definitions.children:
        template = kind.child("PropertyTemplate")
        settings = None if template is None else template.child(SETTINGS)
        for setting in () if settings is None else settings.children:
            match kind.properties[:1], setting.properties[:1]:
                case (str(of_kind),), (str(name),):
                    found.setdefault((of_kind, name), Node(of_kind, (), (Node(SETTINGS, (), (setting,)),)))
    return found
