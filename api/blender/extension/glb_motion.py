"""GLB files of a service: checked before Blender opens them, and the motion of their person read.

A file comes from outside. It may name no other file, its pieces lie inside it, and its numbers are finite.
"""

import json
import math
import struct
from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from api.blender.extension.answers import RequestError
from api.blender.extension.turns import Quat, Vec

_HEAD, _CHUNK = struct.Struct("<4sII"), struct.Struct("<I4s")
_MAX_JSON_BYTES = 32 << 20
_MAX_NODES = 20_000
_MAX_FRAMES = 2_000_000
_FLOAT = 5126
_COMPONENT_BYTES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, _FLOAT: 4}
_NUM_COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_WRONG = "This extension can't open the GLB file of the service."


@dataclass(frozen=True, slots=True)
class GlbFacts:
    """Facts about a file that Blender may open."""

    frame_rate_hz: float
    num_frames: int


@dataclass(frozen=True, slots=True)
class PersonMotion:
    """Motion of a person: a skeleton whose joints have the world's axes in the rest pose, a T-pose on the floor.

    World: metres, Z up, the rest pose faces -Y; quaternions are (w, x, y, z).
    """

    frame_rate_hz: float
    parents: Mapping[str, str | None]  # Joint above each joint, in an order in which it comes first
    offsets_m: Mapping[str, Vec]  # Place of each joint in the rest pose, from its parent; of the root, from the origin
    roots_m: Sequence[Vec]  # Place of the root in each frame
    turns: Mapping[str, Sequence[Quat]]  # Rotation of joints in their parents in each frame; others stay at rest

    @property
    def num_frames(self) -> int:
        """Number of frames."""
        return len(self.roots_m)


class _Reader:
    """Description of a file, and its numbers."""

    def __init__(self, file: BinaryIO) -> None:
        head = file.read(_HEAD.size + _CHUNK.size)
        if len(head) < _HEAD.size + _CHUNK.size:
            raise ValueError
        (magic, version, num_bytes), (length, kind) = _HEAD.unpack_from(head), _CHUNK.unpack_from(head, _HEAD.size)
        if magic != b"glTF" or version != 2 or kind != b"JSON" or length > _MAX_JSON_BYTES:
            raise ValueError
        document = json.loads(file.read(length))
        self._start = _HEAD.size + 2 * _CHUNK.size + length
        if not isinstance(document, dict) or file.seek(0, 2) != num_bytes or num_bytes < self._start:
            raise ValueError
        self.document: Mapping[str, Any] = document
        self._file, self._num_bytes = file, num_bytes - self._start
        self._check()

    def read_list(self, name: str) -> Sequence[Mapping[str, Any]]:
        items = self.document.get(name, [])
        if isinstance(items, list) and len(items) <= _MAX_NODES and all(isinstance(item, dict) for item in items):
            return items
        raise ValueError

    def _check(self) -> None:
        """Raise ``ValueError`` for other files that are named, and pieces that don't lie in the file."""
        for name in ("buffers", "images"):
            if any("uri" in item for item in self.read_list(name)):
                raise ValueError
        views = self.read_list("bufferViews")
        for view in views:
            if natural(view.get("byteOffset", 0)) + natural(view["byteLength"]) > self._num_bytes:
                raise ValueError
        for accessor in self.read_list("accessors"):
            if "sparse" in accessor or "bufferView" not in accessor:
                raise ValueError
            view = views[natural(accessor["bufferView"])]
            width = _COMPONENT_BYTES[accessor["componentType"]] * _NUM_COMPONENTS[accessor["type"]]
            count, stride = natural(accessor["count"]), natural(view.get("byteStride", width))
            if count and natural(accessor.get("byteOffset", 0)) + (count - 1) * stride + width > view["byteLength"]:
                raise ValueError
        for node in self.read_list("nodes"):
            for child in node.get("children", ()):
                self.read_list("nodes")[natural(child)]
        if not all(isinstance(mesh.get("primitives"), list) for mesh in self.read_list("meshes")):
            raise ValueError

    def floats(self, number: Any, kind: str) -> "array[float]":
        """Numbers of an accessor without gaps, one after the other; all finite."""
        accessor = self.read_list("accessors")[natural(number)]
        view = self.read_list("bufferViews")[natural(accessor["bufferView"])]
        if accessor["componentType"] != _FLOAT or accessor["type"] != kind or "byteStride" in view:
            raise ValueError
        size = natural(accessor["count"]) * _NUM_COMPONENTS[kind]
        self._file.seek(self._start + view.get("byteOffset", 0) + accessor.get("byteOffset", 0))
        values = array("f", self._file.read(4 * size))
        if array("H", [1]).tobytes() == b"\0\1":
            values.byteswap()
        if len(values) != size or not all(map(math.isfinite, values)):
            raise ValueError
        return values

    def animation(self) -> Mapping[str, Any]:
        """The animation of the file."""
        (animation,) = self.read_list("animations")
        return animation

    def facts(self) -> GlbFacts:
        animation = self.animation()
        rate_hz = animation.get("extras", {}).get("frame_rate_hz")
        if not isinstance(rate_hz, (int, float)) or not 0.0 < rate_hz <= 10_000.0:
            raise ValueError
        counts = {
            natural(self.read_list("accessors")[natural(sampler["input"])]["count"])
            for sampler in animation["samplers"]
        }
        (num_frames,) = counts
        if num_frames > _MAX_FRAMES:
            raise ValueError
        return GlbFacts(float(rate_hz), num_frames)


def natural(value: Any) -> int:
    """Natural number of a file. Raises ``ValueError`` for anything else."""
    if isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 1 << 40:
        return value
    raise ValueError


def check_glb(path: Path) -> GlbFacts:
    """Check that Blender may open a file. Raises ``RequestError`` if it is wrong."""
    try:
        with path.open("rb") as file:
            return _Reader(file).facts()
    except (ValueError, KeyError, IndexError, TypeError, AttributeError, RecursionError) as error:
        raise RequestError(_WRONG) from error


def read_motion(path: Path) -> PersonMotion:
    """Read the motion of the person in a file. Raises ``RequestError`` if it is wrong, or holds several people."""
    try:
        with path.open("rb") as file:
            return _motion(_Reader(file))
    except (ValueError, KeyError, IndexError, TypeError, AttributeError, RecursionError) as error:
        raise RequestError(_WRONG) from error


def _motion(reader: _Reader) -> PersonMotion:
    facts, nodes = reader.facts(), reader.read_list("nodes")
    (skin,) = reader.read_list("skins")
    joints = [natural(number) for number in skin["joints"]]
    names = {number: nodes[number]["name"] for number in joints}
    above = {child: number for number, node in enumerate(nodes) for child in node.get("children", ())}
    if (
        not joints
        or len(set(names.values())) < len(joints)
        or not all(isinstance(name, str) for name in names.values())
    ):
        raise ValueError
    animation = reader.animation()
    outputs = {
        (channel["target"].get("node"), channel["target"]["path"]): animation["samplers"][channel["sampler"]]["output"]
        for channel in animation["channels"]
    }
    parents: dict[str, str | None] = {}
    offsets_m: dict[str, Vec] = {}
    turns: dict[str, Sequence[Quat]] = {}
    for place, number in enumerate(joints):
        parent = names.get(above.get(number, -1))
        if parent not in (parents if place else {None}):
            raise ValueError  # A parent comes before its children, and there is one root.
        parents[names[number]] = parent
        x, y, z = (float(value) for value in nodes[number].get("translation", (0.0, 0.0, 0.0)))
        offsets_m[names[number]] = (x, -z, y)
        if (number, "rotation") in outputs:
            values = reader.floats(outputs[number, "rotation"], "VEC4")
            turns[names[number]] = [
                (w, x, -z, y) for x, y, z, w in zip(*(values[start::4] for start in range(4)), strict=True)
            ]
    values = reader.floats(outputs[joints[0], "translation"], "VEC3")
    roots_m = [(x, -z, y) for x, y, z in zip(*(values[start::3] for start in range(3)), strict=True)]
    if any(len(keys) != facts.num_frames for keys in (roots_m, *turns.values())):
        raise ValueError
    return PersonMotion(facts.frame_rate_hz, parents, offsets_m, roots_m, turns)
