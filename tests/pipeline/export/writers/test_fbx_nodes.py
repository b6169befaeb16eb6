"""Nodes of binary FBX: layout, and bounds of damaged files."""

import contextlib
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.export.writers import fbx_nodes
from pipeline.export.writers.fbx_nodes import ArrayProperty, FbxError, Int64, Node, array, late_array, read, write

NUMBERS = np.arange(100) * 0.5
TREE = (
    Node(
        "Objects",
        (),
        (
            Node("Model", (Int64(2**40), "Anna\x00\x01Model", "LimbNode"), (Node("Version", (232,)),)),
            Node("Values", (True, 2.5, b"\x00\xff", array("d", NUMBERS), array("i", [1, -2]))),
            Node("Late", (late_array("f", 100, lambda: NUMBERS),)),
        ),
    ),
    Node("References"),
)


def content_of(*nodes: Node) -> bytes:
    return b"".join(write(lambda _: nodes))


def plain(node: Node) -> tuple[object, ...]:
    """Node with arrays as lists."""
    values = [value.values().tolist() if isinstance(value, ArrayProperty) else value for value in node.properties]
    return node.name, values, [plain(child) for child in node.children]


@pytest.fixture(params=[7400, 7500])
def version(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> int:
    """Version of files: the later one is for files that are large."""
    if request.param == 7500:
        monkeypatch.setattr(fbx_nodes, "MAX_NARROW_BYTES", 0)
    return int(request.param)


def test_nodes_are_read_as_they_were_written(version: int) -> None:
    content = content_of(*TREE)
    assert struct.unpack_from("<I", content, 23) == (version,)
    assert [plain(node) for node in read(content)] == [plain(node) for node in TREE]
    (top, _) = read(content)
    (identity, _, _) = top.children[0].properties
    assert isinstance(identity, Int64)


def test_layout_is_that_of_format(version: int) -> None:
    """Offsets by hand: a node states its end, its number of properties and their size; lists end with zeros."""
    content = content_of(Node("Ab", (7,), (Node("C", ("x",)),)))
    form, width = ("<III", 13) if version == 7400 else ("<QQQ", 25)
    assert content[:23] == b"Kaydara FBX Binary  \x00\x1a\x00"
    end_of_child = 27 + width + 2 + 5 + width + 1 + 6
    assert struct.unpack_from(form, content, 27) == (end_of_child + width, 1, 5)
    assert content[27 + width - 1 : 27 + width + 7] == b"\x02AbI\x07\x00\x00\x00"
    child = 27 + width + 7
    assert struct.unpack_from(form, content, child) == (end_of_child, 1, 6)
    assert content[child + width - 1 : end_of_child] == b"\x01CS\x01\x00\x00\x00x"
    assert not any(content[end_of_child : end_of_child + 2 * width])
    footer = content[end_of_child + 2 * width :]
    assert footer.startswith(bytes.fromhex("fabcab09d0c8d466b176fb831cf7267e") + bytes(4))
    assert footer.endswith(struct.pack("<I", version) + bytes(120) + bytes.fromhex("f85a8c6adef5d97eece90ce3758f290b"))
    assert (len(content) - 140) % 16 == 0


def test_ids_belong_to_time_of_creation() -> None:
    """The ids of files and of footers are made from the time of creation, as other writers do it."""
    seconds, month, hour, day, hundredths, year, minute = 0, 1, 10, 1, 0, 1970, 0
    assert f"{year}-{month:02}-{day:02} {hour:02}:{minute:02}:{seconds:02}:000" == fbx_nodes.CREATED
    time = f"{seconds:02}{month:02}{hour:02}{day:02}{hundredths:02}{year:04}{minute:02}".encode()

    def mixed(content: bytes, key: bytes) -> bytes:
        made, before = [], 64
        for byte, of_key in zip(content, key, strict=True):
            before ^= byte ^ of_key
            made.append(before)
        return bytes(made)

    source = bytes.fromhex("58aba9f06ca2d83f4d4749a3b4b2e73d")
    key = bytes.fromhex("e24f7b5fcde4c86ddbd8fbd74058c678")
    assert mixed(source, time) == fbx_nodes.FILE_ID
    assert mixed(mixed(mixed(source, time), key), time) in content_of(*TREE)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "no binary FBX"),
        (b"; FBX 7.4.0 project file\n" * 9, "no binary FBX"),
        (b"Kaydara FBX Binary  \x00\x1a\x00" + struct.pack("<I", 6100), "version 6100 is not supported"),
        (b"Kaydara FBX Binary  \x00\x1a\x00" + struct.pack("<I", 7400), "cut off"),
    ],
)
def test_other_files_are_refused(content: bytes, message: str) -> None:
    with pytest.raises(FbxError, match=message):
        read(content)


def test_array_larger_than_its_bounds_is_not_decompressed() -> None:
    bomb = array("d", np.zeros(2**16))
    stated = ArrayProperty("d", 2**31, True, bomb.num_bytes, bomb.content)
    with pytest.raises(FbxError, match="bytes"):
        stated.values()
    with pytest.raises(FbxError, match="bytes instead of"):
        ArrayProperty("d", 3, True, bomb.num_bytes, bomb.content).values()


def test_nodes_have_bounded_depth() -> None:
    deep = Node("A", (1,))
    for _ in range(100):
        deep = Node("A", (), (deep,))
    with pytest.raises(FbxError, match="levels"):
        read(content_of(deep))


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_damaged_files_are_read_or_refused(data: st.DataObject) -> None:
    content = bytearray(content_of(*TREE))
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 200))] = data.draw(st.integers(0, 255))
    content = content[: data.draw(st.sampled_from([len(content), len(content) // 2, 40]))]
    with contextlib.suppress(FbxError):
        [plain(node) for node in read(bytes(content))]
