"""Zips: bioCV, and archives of strangers. EasyMocap and COLMAP are tested with their readers."""

import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from pipeline.calibration.registry import read_contents
from pipeline.core.data.cameras import Camera
from tests.pipeline.calibration.readers.rigs import RIG, assert_rig, problems_of


def write_zip(path: Path, files: Mapping[str, str | bytes]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return path


def biocv(one: Camera, number: Callable[[float], str] = repr) -> str:
    """File of one camera: sizes, K, transform in millimetres, distortion, each after an empty line."""
    pose = one.cam_from_world
    rows = [
        [*row, 1000.0 * shift] for row, shift in zip(pose.rotation.tolist(), pose.translation_m.tolist(), strict=True)
    ]
    lines = [str(one.size_px[0]), str(one.size_px[1])]
    lines += [" ".join(map(number, row)) for row in one.matrix.tolist()]
    lines += ["", *(" ".join(map(number, row)) for row in [*rows, [0.0, 0.0, 0.0, 1.0]]), ""]
    return "\n".join([*lines, " ".join(map(number, one.distortion.tolist())), ""])


@pytest.mark.parametrize(
    ("number", "num_digits"), [(repr, 9), ("{:f}".format, 2), ("{:.6g}".format, 1)], ids=["Python", "script", "C++"]
)
def test_biocv(tmp_path: Path, number: Callable[[float], str], num_digits: int) -> None:
    """The programs of the data set write six digits, or six decimals."""
    files = {f"{camera.name}.calib": biocv(camera, number) for camera in RIG}
    contents = read_contents(write_zip(tmp_path / "rig.zip", files))
    assert (contents.format, contents.unit) == ("bioCV", "mm")
    assert_rig(contents, num_digits=num_digits)


@pytest.mark.parametrize(
    ("files", "code"),
    [
        ({}, "calibration_format"),
        ({"readme.txt": "hello"}, "calibration_format"),
        ({"a.yml": "%YAML:1.0\n---\nimage_width: 3\n"}, "calibration_format"),
        ({"a.yml": "%YAML:1.0\n---\na: [1"}, "calibration_unreadable"),
        ({"intri.yml": "- 1", "extri.yml": "- 1"}, "calibration_unreadable"),
        ({"intri.yml": "names: [a]", "extri.yml": "names: [a]"}, "calibration_format"),
        ({"a.calib": "1 2 3"}, "calibration_unreadable"),
        ({"a.calib": b"\xff\xfe"}, "calibration_unreadable"),
        ({"a.calib": biocv(RIG[0]).replace("0.0 0.0 0.0 1.0", "0.0 0.0 1.0 1.0")}, "calibration_unreadable"),
        ({"bomb.yml": b"\0" * 20 * 2**20}, "calibration_unreadable"),
        ({f"{k}.yml": "" for k in range(300)}, "calibration_unreadable"),
    ],
)
def test_archives_that_are_refused(tmp_path: Path, files: dict[str, str | bytes], code: str) -> None:
    assert problems_of(write_zip(tmp_path / "rig.zip", files)) == [(code, None)]


def test_damaged_archive(tmp_path: Path) -> None:
    path = write_zip(tmp_path / "rig.zip", {"a.calib": biocv(RIG[0])})
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    assert problems_of(path) == [("calibration_unreadable", None)]
    path.write_bytes(content[:60] + b"xxxx" + content[64:])
    assert problems_of(path) == [("calibration_unreadable", None)]


def test_paths_in_archive_are_not_followed(tmp_path: Path) -> None:
    path = write_zip(tmp_path / "rig.zip", {f"../../{one.name}.calib": biocv(one) for one in RIG})
    assert_rig(read_contents(path))
