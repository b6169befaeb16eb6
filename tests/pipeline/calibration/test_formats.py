"""Calibration formats: declared by readers."""

from collections import Counter

import pytest

from pipeline.calibration.registry import calibration_readers, reader_of_file, reader_of_root


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
