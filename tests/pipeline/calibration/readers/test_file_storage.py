"""The parser of FileStorage: values, and files of strangers."""

import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.calibration.readers.file_storage import read_object, read_xml, read_yaml
from pipeline.calibration.registry import read_contents
from pipeline.core.errors import InputError
from pipeline.core.parsing import UnreadableError

YAML = b"""%YAML:1.0
---
names:
   - "01"
   - cam two
numbers: [ 1, 2., 3.e-03, -.5, .Nan, .Inf, -.Inf ]
matrix: !!opencv-matrix
   rows: 2
   cols: 3
   dt: d
   data: [ 1., 2., 3., 4.,
       5., 6. ]
nested: { a: 1, b: "2" }
"""


def test_values_of_yaml() -> None:
    read = read_yaml(YAML)
    assert read["names"] == ["01", "cam two"]
    assert read["numbers"][:4] == [1, 2, 0.003, -0.5]
    assert math.isnan(read["numbers"][4])
    assert read["numbers"][5:] == [math.inf, -math.inf]
    assert read["matrix"] == [[1, 2, 3], [4, 5, 6]]
    assert read["nested"] == {"a": 1, "b": "2"}


def test_values_of_xml() -> None:
    content = b"""<?xml version="1.0"?>
<opencv_storage>
<names>"01" cam</names>
<matrix type_id="opencv-matrix"><rows>1</rows><cols>2</cols><dt>d</dt><data>1. 2.5e+01</data></matrix>
<one type_id="opencv-matrix"><rows>1</rows><cols>1</cols><dt>d</dt><data>7.</data></one>
<list><_>1 2</_><_>3</_></list>
</opencv_storage>"""
    assert read_xml(content) == {"names": ["01", "cam"], "matrix": [[1, 25]], "one": [[7]], "list": [[1, 2], 3]}


@pytest.mark.parametrize(
    "content",
    [
        b"a: &x 1\nb: *x\n",  # aliases: a billion laughs are built of them
        b"a: &x [1]\n",
        b"a: 1\na: 2\n",
        b"---\na: 1\n---\na: 2\n",
        b"? [1, 2]\n: 3\n",
        b"a: " + b"[" * 5000,
        b"a: " + b"{b: " * 30 + b"1" + b"}" * 30,
        b"a: [" + b"1," * 300_000 + b"]",
        b"a: {rows: 2, cols: 2, data: [1, 2, 3]}",
        b"a: {rows: 1e9, cols: 0, data: []}",
        b"a: {rows: .nan, cols: 1, data: []}",
        b"- 1\n",
        b"just words",
        b"\xff\xfe",
        b"a: \x00",
        b"%TAG ! tag:yaml.org,2002:python/object/apply:os.system\n--- !",
    ],
)
def test_yaml_that_is_refused(content: bytes) -> None:
    with pytest.raises(UnreadableError):
        read_yaml(content)


@pytest.mark.parametrize(
    "content",
    [
        b'<!DOCTYPE x [<!ENTITY a "b">]><opencv_storage><a>&a;</a></opencv_storage>',
        b"<opencv_storage><a>1</a><a>2</a></opencv_storage>",
        b"<opencv_storage>1</opencv_storage>",
        b"<a>" * 50 + b"</a>" * 50,
        b"<opencv_storage>",
    ],
)
def test_xml_that_is_refused(content: bytes) -> None:
    with pytest.raises(UnreadableError):
        read_xml(content)


def test_json_that_is_refused() -> None:
    for content in (b"[1]", b'{"a": {"rows": 1, "cols": true, "data": [1]}}', b'{"a":' * 30 + b"1" + b"}" * 30):
        with pytest.raises(UnreadableError):
            read_object(content)


def test_tags_create_no_objects() -> None:
    assert read_yaml(b"a: !!python/object/apply:os.getcwd []\n") == {"a": []}


@given(cut=st.integers(0, len(YAML)), noise=st.binary(max_size=8))
def test_damaged_yaml_is_read_or_refused(tmp_path_factory: pytest.TempPathFactory, cut: int, noise: bytes) -> None:
    path: Path = tmp_path_factory.getbasetemp() / "damaged.yml"
    path.write_bytes(YAML[:cut] + noise + YAML[cut + len(noise) :])
    with pytest.raises(InputError):
        read_contents(path)
