"""Calibration formats: declared by readers, and documented by their docstrings."""

import ast
import re
from collections import Counter
from pathlib import Path

import pytest

from pipeline.calibration import readers
from pipeline.calibration.registry import calibration_readers, reader_of_file, reader_of_root

ROOT = Path(__file__).parents[3]


def documented() -> list[str]:
    """Rows of the table of formats in the docstrings of the readers' modules."""
    rows: list[str] = []
    for path in Path(readers.__path__[0]).glob("*.py"):
        text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
        _, _, table = text.partition("Rows of the table of formats:")
        rows += re.findall(r"\|(?:[^|]*\|){4}", " ".join(table.split()))
    return rows


def test_table_of_formats_is_one_of_readers() -> None:
    text = (ROOT / "docs" / "formats.md").read_text(encoding="utf-8")
    table = text[text.index("| format | file, recognised by | lengths |") :].partition("\n\n")[0]
    assert sorted(documented()) == sorted(table.splitlines()[2:])


def test_each_ending_and_root_has_one_reader() -> None:
    known = calibration_readers()
    counts = Counter(part for each in known for part in (*each.suffixes, *each.roots))
    assert len(counts) > 10
    assert set(counts.values()) == {1}


@pytest.mark.parametrize(
    ("name", "content", "expected"),
    [
        ("a.TOML", b"", "TOML of Caliscope, anipose, Pose2Sim and FreeMoCap"),
        ("a.json", b"PK\x03\x04", "JSON"),
        ("a.txt", b"PK\x03\x04", "Archive of several files"),
        ("a.txt", b"%YAML:1.0", "OpenCV FileStorage"),
        ("a.txt", b"# CAMERA_ID, MODEL, WIDTH, HEIGHT\n# IMAGE_ID, QW, QX, QY, QZ\n", "COLMAP text"),
        ("a.txt", b"words", None),
    ],
)
def test_reader_of_file_by_ending_or_content(name: str, content: bytes, expected: str | None) -> None:
    found = reader_of_file(name, content, content)
    assert (None if found is None else found.name) == expected


@pytest.mark.parametrize(
    ("root", "expected"), [("QTM_Parameters_Ver_1.25", "Qualisys QCA"), ("Cameras", "Vicon"), ("calibrations", None)]
)
def test_reader_of_root_by_pattern(root: str, expected: str | None) -> None:
    found = reader_of_root(root)
    assert (None if found is None else found.name) == expected
