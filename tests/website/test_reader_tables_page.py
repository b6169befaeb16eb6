"""The generated page of formats has every registered reader, rows of whole cells, and examples that are read."""

import re
import sys
from pathlib import Path

import pytest

from pipeline.calibration.readers import fields
from pipeline.calibration.registry import calibration_readers, reader_of_file
from pipeline.capture.keypoint_files.forms import keypoint_readers
from website.reader_tables_page import CALIBRATIONS, KEYPOINTS, document, reader_rows

NUM_CELLS, MAX_CELL = 4, 200


def rows_of(heading: str) -> list[list[str]]:
    """Rows of the table of a section, as cells without the head."""
    section = document().partition(f"\n## {heading}\n")[2].partition("\n## ")[0]
    return [line.strip("| ").split(" | ") for line in section.splitlines() if line.startswith("| ")][2:]


@pytest.mark.parametrize("module", sorted({reader.read.__module__ for reader in calibration_readers()}))
def test_calibration_reader_has_rows(module: str) -> None:
    if not module.startswith("pipeline."):
        pytest.skip("a reader of another package has no row")
    rows = reader_rows(Path(str(sys.modules[module].__file__)))
    assert rows
    assert set(rows) <= set(document().splitlines())


@pytest.mark.parametrize("name", sorted({reader.name for reader in keypoint_readers()}))
def test_keypoint_reader_has_row(name: str) -> None:
    assert any(re.match(rf"{name}\b", first) for first, *_ in rows_of("Keypoint formats"))


@pytest.mark.parametrize(
    ("heading", "folder", "least"), [("Calibration formats", CALIBRATIONS, 18), ("Keypoint formats", KEYPOINTS, 11)]
)
def test_every_row_of_docstrings_is_in_page(heading: str, folder: Path, least: int) -> None:
    rows = rows_of(heading)
    marked = [path for path in folder.glob("*.py") if "Rows of the table of formats:" in path.read_text("utf-8")]
    written = [len(reader_rows(path)) for path in marked]
    assert 0 not in written
    assert len(rows) == sum(written) >= least
    assert {len(row) for row in rows} == {NUM_CELLS}
    assert [cell for row in rows for cell in row if len(cell) > MAX_CELL] == []


def test_names_of_fields_are_read() -> None:
    names = {name for _, cell in rows_of("Names of fields") for name in re.findall(r"`([A-Za-z_]+)`", cell)}
    assert {"camera_matrix", "distCoeffs", "rvec", "tvec", "RT", "fisheye"} <= names
    assert all(fields.is_camera({name: 1}) for name in ("camera_matrix", "rvec", "tvec", "RT"))


@pytest.mark.parametrize(("language", "suffix"), [("json", ".json"), ("toml", ".toml"), ("yaml", ".yml")])
def test_example_of_calibration_is_read(language: str, suffix: str) -> None:
    (example,) = re.findall(rf"^```{language}\n(.*?)^```$", document(), re.MULTILINE | re.DOTALL)
    content = example.encode()
    read = reader_of_file(f"rig{suffix}", content, content)
    assert read is not None
    (camera,) = read(content, f"rig{suffix}").cameras
    assert camera.name == "left"
    assert list(camera.cam_from_world.translation_m) == [0.1, -0.2, 3.5]
