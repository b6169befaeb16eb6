"""Binary FBX: a tree of nodes with properties, written piece by piece, and read within bounds.

The layout is as in versions 7.4 and 7.5, which differ in the width of their offsets: 32 and 64 bits. Each node states
where it ends, so all sizes are known before the first byte is written. Numbers are little-endian.
"""

import struct
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from jaxtyping import Shaped

CREATED = "1970-01-01 10:00:00:000"
"""Time of creation in all files, so that equal contents give equal bytes; ``FILE_ID`` and the footer depend on it."""

FILE_ID = bytes.fromhex("28b32aebb624ccc2bfc8b02aa92bfcf1")
"""Content of the node ``FileId`` of files of the time ``CREATED``."""

_MAGIC = b"Kaydara FBX Binary  \x00\x1a\x00"
# Versions, and the sizes of their offsets in bytes.
_VERSIONS = (7400, 4), (7500, 8)
# Readers take offsets of 32 bits as signed numbers. A megabyte is for what is around the nodes.
MAX_NARROW_BYTES = 2**31 - 2**20
_FOOTER_ID = bytes.fromhex("fabcab09d0c8d466b176fb831cf7267e")
_FOOTER_END = bytes.fromhex("f85a8c6adef5d97eece90ce3758f290b")
_FOOTER_ALIGNMENT, _FOOTER_ZEROS = 16, 120
# Nodes without children that end like nodes with children.
_ALWAYS_ENDED = frozenset({"AnimationStack", "AnimationLayer"})
_ARRAYS: Mapping[str, np.dtype[Any]] = MappingProxyType(
    {
        "b": np.dtype("?"),
        "c": np.dtype("u1"),
        "i": np.dtype("<i4"),
        "l": np.dtype("<i8"),
        "f": np.dtype("<f4"),
        "d": np.dtype("<f8"),
    }
)
_ARRAY_HEAD, _LENGTH = struct.Struct("<III"), struct.Struct("<I")
_SCALARS: Mapping[str, struct.Struct] = MappingProxyType(
    {code: struct.Struct(f"<{form}") for code, form in zip("CBZYILFD", "?BBhiqfd", strict=True)}
)
# Arrays of fewer bytes are stored as they are.
_COMPRESSED_FROM_BYTES = 128
# Bounds of files that are read.
_MAX_DEPTH, _MAX_NODES, _MAX_ARRAY_BYTES = 64, 1_000_000, 2**28


class FbxError(ValueError):
    """A file is no binary FBX, or is damaged."""


class Int64(int):
    """Integer property of 64 bits; others have 32."""


@dataclass(frozen=True, slots=True, eq=False)
class ArrayProperty:
    """Array as a property, of which only its size is known until it is needed."""

    code: str  # Type of the elements: ``b``, ``c``, ``i``, ``l``, ``f`` or ``d``
    length: int  # Number of elements
    is_compressed: bool
    num_bytes: int  # Size in the file
    content: Callable[[], bytes | memoryview]  # Bytes in the file

    def values(self) -> Shaped[np.ndarray, " length"]:
        """Elements of the array; ``FbxError`` if it is damaged or larger than 256 MiB."""
        dtype, content = _ARRAYS[self.code], self.content()
        size = self.length * dtype.itemsize
        if size > _MAX_ARRAY_BYTES:
            raise FbxError(f"an array has {size:,} bytes")
        if self.is_compressed:
            decompressor = zlib.decompressobj()
            try:
                content = decompressor.decompress(content, size + 1)
            except zlib.error as error:
                raise FbxError(f"an array can't be decompressed: {error}") from error
        if len(content) != size:
            raise FbxError(f"an array has {len(content):,} bytes instead of {size:,}")
        return np.frombuffer(content, dtype)


Property = bool | int | float | str | bytes | ArrayProperty
"""Value of a node; of integers ``Int64`` has 64 bits."""


@dataclass(frozen=True, slots=True)
class Node:
    """Node of a file: a name, values and other nodes."""

    name: str
    properties: tuple[Property, ...] = ()
    children: tuple["Node", ...] = ()

    def child(self, name: str) -> "Node | None":
        """First child of a name; ``None`` if there is none."""
        return next((child for child in self.children if child.name == name), None)


def array(code: str, values: Shaped[np.ndarray, " length"] | Sequence[float] | Sequence[int]) -> ArrayProperty:
    """Array of some values, compressed unless it is short; ``code`` is the type of its elements."""
    content = np.ascontiguousarray(values, _ARRAYS[code]).tobytes()
    is_compressed = len(content) >= _COMPRESSED_FROM_BYTES
    stored = zlib.compress(content) if is_compressed else content
    return ArrayProperty(code, len(values), is_compressed, len(stored), lambda: stored)


def late_array(code: str, length: int, make: Callable[[], Shaped[np.ndarray, " length"]]) -> ArrayProperty:
    """Array whose values are made when it is written, so that not all arrays are in memory; not compressed."""
    dtype = _ARRAYS[code]
    return ArrayProperty(
        code, length, False, length * dtype.itemsize, lambda: np.ascontiguousarray(make(), dtype).tobytes()
    )


def write(nodes_of: Callable[[int], Iterable[Node]]) -> Iterator[bytes]:
    """Write the nodes of a file, piece by piece; ``nodes_of`` gives the nodes of a version.

    The version is 7.4, or 7.5 for files of 2 GiB and more, whose offsets need 64 bits.
    """
    version, width, nodes = _measured(nodes_of)
    place = len(_MAGIC) + _LENGTH.size
    yield _MAGIC + _LENGTH.pack(version)
    for node in nodes:
        yield from _write_node(node, place, width)
        place += node.size
    end = bytes(_head_size(width)) + _FOOTER_ID + bytes(4)
    padding = _FOOTER_ALIGNMENT - (place + len(end)) % _FOOTER_ALIGNMENT
    yield end + bytes(padding) + _LENGTH.pack(version) + bytes(_FOOTER_ZEROS) + _FOOTER_END


def _measured(nodes_of: Callable[[int], Iterable[Node]]) -> tuple[int, int, list["_Measured"]]:
    """Version of a file, the size of its offsets in bytes, and its nodes."""
    for version, width in _VERSIONS[:-1]:
        nodes = [_measure(node, width) for node in nodes_of(version)]
        if sum(node.size for node in nodes) < MAX_NARROW_BYTES:
            return version, width, nodes
    version, width = _VERSIONS[-1]
    return version, width, [_measure(node, width) for node in nodes_of(version)]


@dataclass(frozen=True, slots=True)
class _Measured:
    """Node whose size is known."""

    node: Node
    children: tuple["_Measured", ...]
    size_of_properties: int
    size: int

    @property
    def is_ended(self) -> bool:
        return _is_ended(self.node)


def _is_ended(node: Node) -> bool:
    """True if a node ends with an empty head."""
    return bool(node.children) or not node.properties or node.name in _ALWAYS_ENDED


def _measure(node: Node, width: int) -> _Measured:
    children = tuple(_measure(child, width) for child in node.children)
    size_of_properties = sum(_size(value) for value in node.properties)
    size = _head_size(width) + len(node.name) + size_of_properties + sum(child.size for child in children)
    return _Measured(node, children, size_of_properties, size + _head_size(width) * _is_ended(node))


def _head_size(width: int) -> int:
    """Size of a node without name and content: its end, two numbers about its properties, the length of its name."""
    return 3 * width + 1


def _size(value: Property) -> int:
    match value:
        case ArrayProperty():
            return 1 + _ARRAY_HEAD.size + value.num_bytes
        case str():
            return 5 + len(_encoded(value))
        case bytes():
            return 5 + len(value)
        case _:
            return 1 + _SCALARS[_scalar_code(value)].size


def _scalar_code(value: float) -> str:
    match value:
        case bool():
            return "C"
        case Int64():
            return "L"
        case int():
            return "I"
        case _:
            return "D"


def _encoded(text: str) -> bytes:
    return text.encode("utf-8", errors="replace")


def _write_node(measured: _Measured, start: int, width: int) -> Iterator[bytes]:
    node = measured.node
    name = node.name.encode("ascii")
    numbers = (start + measured.size, len(node.properties), measured.size_of_properties)
    yield struct.pack("<III" if width == 4 else "<QQQ", *numbers) + bytes([len(name)]) + name
    for value in node.properties:
        yield from _write_property(value)
    place = start + _head_size(width) + len(name) + measured.size_of_properties
    for child in measured.children:
        yield from _write_node(child, place, width)
        place += child.size
    if measured.is_ended:
        yield bytes(_head_size(width))


def _write_property(value: Property) -> Iterator[bytes]:
    match value:
        case ArrayProperty():
            yield value.code.encode("ascii")
            yield _ARRAY_HEAD.pack(value.length, value.is_compressed, value.num_bytes)
            yield bytes(value.content())
        case str() | bytes():
            content = _encoded(value) if isinstance(value, str) else value
            yield (b"S" if isinstance(value, str) else b"R") + _LENGTH.pack(len(content)) + content
        case _:
            code = _scalar_code(value)
            yield code.encode("ascii") + _SCALARS[code].pack(value)


def read(stored: bytes | memoryview) -> tuple[Node, ...]:
    """Read the nodes of a file; the bytes must stay while arrays are read.

    Raises ``FbxError`` if the content is no binary FBX of versions 7.x, sizes contradict each other, or there are more
    than a million nodes or 64 levels of them.
    """
    content, start = memoryview(stored), len(_MAGIC) + _LENGTH.size
    if len(content) < start or content[: len(_MAGIC)] != _MAGIC:
        raise FbxError("no binary FBX")
    (version,) = _LENGTH.unpack_from(content, len(_MAGIC))
    if not 7000 <= version < 8000:
        raise FbxError(f"version {version} is not supported")
    nodes, end = _Reader(content, 4 if version < 7500 else 8).nodes(start, len(content), 0)
    if end == len(content):
        raise FbxError("the file is cut off")
    return nodes


class _Reader:
    """Reader of the nodes of a file; ``width`` is the size of its offsets in bytes."""

    def __init__(self, content: memoryview, width: int) -> None:
        self._content, self._width = content, width
        self._head = struct.Struct("<III" if width == 4 else "<QQQ")
        self._num_nodes = 0

    def nodes(self, place: int, stop: int, depth: int) -> tuple[tuple[Node, ...], int]:
        """Nodes from a place on up to an empty head, which ends a list before ``stop``; and the place behind it."""
        if depth > _MAX_DEPTH:
            raise FbxError(f"nodes have more than {_MAX_DEPTH} levels")
        nodes: list[Node] = []
        while place < stop:
            end, num_properties, size, name_length = self._head_at(place, stop)
            if end == 0:
                return tuple(nodes), place + self._head.size + 1
            self._num_nodes += 1
            if self._num_nodes > _MAX_NODES:
                raise FbxError(f"more than {_MAX_NODES:,} nodes")
            first = place + self._head.size + 1 + name_length
            last = first + size
            if not first <= last <= end <= stop:
                raise FbxError("a node has sizes that contradict each other")
            name = bytes(self._content[first - name_length : first]).decode("utf-8", errors="replace")
            properties = self._properties(first, last, num_properties)
            children, behind = self.nodes(last, end, depth + 1)
            if behind != end:
                raise FbxError("a node ends elsewhere than it states")
            nodes.append(Node(name, properties, children))
            place = end
        return tuple(nodes), place

    def _head_at(self, place: int, stop: int) -> tuple[int, int, int, int]:
        if place + self._head.size + 1 > stop:
            raise FbxError("a node is cut off")
        end, num_properties, size = self._head.unpack_from(self._content, place)
        return end, num_properties, size, self._content[place + self._head.size]

    def _properties(self, place: int, stop: int, number: int) -> tuple[Property, ...]:
        values: list[Property] = []
        while place < stop and len(values) < number:
            value, place = self._property(place, stop)
            values.append(value)
        if len(values) != number or place != stop:
            raise FbxError("a node has other properties than it states")
        return tuple(values)

    def _property(self, place: int, stop: int) -> tuple[Property, int]:
        """Read a property before ``stop``, and the place behind it."""
        code = chr(self._content[place])
        place += 1
        if code in _SCALARS:
            (value,) = self._unpacked(_SCALARS[code], place, stop)
            return Int64(value) if code == "L" else value, place + _SCALARS[code].size
        if code in _ARRAYS:
            length, encoding, num_bytes = self._unpacked(_ARRAY_HEAD, place, stop)
            stored, place = self._bytes(place + _ARRAY_HEAD.size, num_bytes, stop)
            if encoding > 1:
                raise FbxError(f"an array has the encoding {encoding}")
            return ArrayProperty(code, length, bool(encoding), num_bytes, lambda: stored), place
        if code in "SR":
            (size,) = self._unpacked(_LENGTH, place, stop)
            stored, place = self._bytes(place + _LENGTH.size, size, stop)
            return bytes(stored).decode("utf-8", errors="replace") if code == "S" else bytes(stored), place
        raise FbxError(f"a property has the type {code!r}")

    def _unpacked(self, form: struct.Struct, place: int, stop: int) -> tuple[Any, ...]:
        if place + form.size > stop:
            raise FbxError("a property is cut off")
        return form.unpack_from(self._content, place)

    def _bytes(self, place: int, size: int, stop: int) -> tuple[memoryview, int]:
        if place + size > stop:
            raise FbxError("a property is cut off")
        return self._content[place : place + size], place + size
