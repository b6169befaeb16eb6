"""Calibration files as editors and programs of any language store them: UTF-16, and decimal commas."""

import re
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from pipeline.calibration.program_files import PROGRAM_FORMATS
from pipeline.calibration.registry import read_contents
from pipeline.core.data.cameras import Camera
from pipeline.core.errors import InputError
from tests.pipeline.calibration.readers import test_colmap, test_qca
from tests.pipeline.calibration.readers.rigs import RIG, assert_rig
from tests.pipeline.calibration.readers.test_archive import biocv, write_zip

XML = '<?xml version="1.0" encoding="UTF-8"?>'
TEXTS = ("multicap", "anipose", "caliscope", "opencv")
ENCODERS = pytest.mark.parametrize(
    ("ending", "encoder"),
    [(PROGRAM_FORMATS[name].endings[0], PROGRAM_FORMATS[name].encode) for name in TEXTS],
    ids=TEXTS,
)
Encoder = Callable[[Sequence[Camera]], bytes]


def with_commas(text: str) -> str:
    return re.sub(r"(?<=\d)\.(?=\d)", ",", text)


@pytest.mark.parametrize("encoding", ["utf-16-le", "utf-16-be"])
@ENCODERS
def test_utf_16(tmp_path: Path, ending: str, encoder: Encoder, encoding: str) -> None:
    path = tmp_path / f"rig{ending}"
    path.write_bytes(f"\ufeff{encoder(RIG).decode()}".encode(encoding))
    contents = read_contents(path, "m")
    for found, expected in zip(contents.cameras, RIG, strict=True):
        np.testing.assert_allclose(found.matrix, expected.matrix)


@pytest.mark.parametrize("head", ["", XML, XML.replace("UTF-8", "UTF-16"), XML.replace("UTF-8", "ISO-8859-1")])
@pytest.mark.parametrize("name", ["calib.qca", "calib.txt", "calib.xml"])
def test_utf_16_of_xml_whatever_it_states(tmp_path: Path, head: str, name: str) -> None:
    (tmp_path / name).write_text(head + test_qca.document(test_qca.camera("24021")), encoding="utf-16")
    assert [camera.name for camera in read_contents(tmp_path / name).cameras] == ["24021"]


def test_utf_16_in_archives(tmp_path: Path) -> None:
    files: dict[str, str | bytes] = {f"{camera.name}.calib": biocv(camera).encode("utf-16") for camera in RIG}
    assert_rig(read_contents(write_zip(tmp_path / "rig.zip", files)))


def test_half_character_of_utf_16_is_refused(tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_bytes("[cam_0]".encode("utf-16") + b"1")
    with pytest.raises(InputError):
        read_contents(tmp_path / "rig.toml")


def test_decimal_commas_in_attributes_are_read(tmp_path: Path) -> None:
    path = tmp_path / "calib.qca"
    text = test_qca.document(test_qca.camera("24021")).replace('r11="1"', 'r11="1,000000"')
    for number in ("1000", "-2000", "1500", "64000", "65280"):
        text = text.replace(f'="{number}"', f'="{number},000000"')
    # Versions keep their points.
    path.write_text(XML + text.replace('="0.1"', '="0,100000"').replace('"0.4"', '"0,400000"'), encoding="utf-16")
    contents = read_contents(path)
    (camera,) = contents.cameras
    assert (camera.matrix[0, 0], camera.matrix[1, 1]) == (1000.0, 1020.0)
    np.testing.assert_array_equal(camera.distortion, [0.1, 0.0, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(camera.cam_from_world.inverse().translation_m, [1.0, -2.0, 1.5])
    assert contents.notes[-1] == "calib.qca: the numbers have decimal commas, such as 0,400000, and are read so."


def test_decimal_commas_between_spaces_are_read(tmp_path: Path) -> None:
    path = tmp_path / "model.txt"
    path.write_text(with_commas("".join(test_colmap.parts())))
    contents = read_contents(path, "m")
    # Names of images have endings.
    assert_rig(contents, test_colmap.COLMAP_RIG)
    assert "decimal commas" in contents.notes[-1]


@ENCODERS
def test_decimal_commas_between_commas_are_named(tmp_path: Path, ending: str, encoder: Encoder) -> None:
    path = tmp_path / f"rig{ending}"
    path.write_text(with_commas(encoder(RIG).decode()))
    with pytest.raises(InputError) as error:
        read_contents(path, "m")
    (problem,) = error.value.problems
    assert problem.message.startswith("The numbers have decimal commas, such as ")
    assert problem.hint == "Write decimal points."


def test_decimal_commas_in_archives_are_named(tmp_path: Path) -> None:
    files: dict[str, str | bytes] = {f"{camera.name}.calib": with_commas(biocv(camera)) for camera in RIG}
    with pytest.raises(InputError, match="decimal commas"):
        read_contents(write_zip(tmp_path / "rig.zip", files))


def test_other_faults_have_their_own_reason(tmp_path: Path) -> None:
    path = tmp_path / "rig.json"
    path.write_text('{"cameras": [{"name": "a", "K": [[1000,0,960],[0,1000,540],[0,0,1]], "resolution": [1920,1080]}]}')
    with pytest.raises(InputError) as error:
        read_contents(path, "m")
    assert "commas" not in str(error.value)
