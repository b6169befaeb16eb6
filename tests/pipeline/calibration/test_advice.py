"""Messages about files that are no calibration: what they are, and what to do."""

import zipfile
from pathlib import Path

import pytest

from pipeline.calibration.registry import read_contents
from pipeline.core.errors import InputError, Problem


def refusal(path: Path, content: bytes) -> Problem:
    path.write_bytes(content)
    with pytest.raises(InputError) as error:
        read_contents(path)
    (problem,) = error.value.problems
    return problem


@pytest.mark.parametrize(
    ("name", "what", "advice"),
    [
        ("System.cal", "a calibration of Motive before 3.2", "export it as .mcal"),
        ("cameras.bin", "a binary model, like COLMAP's", "model_converter"),
        ("stereo.MAT", "a file of MATLAB", "OpenCV's YAML"),
        ("calib.npz", "a file of NumPy", "OpenCV's YAML"),
    ],
)
def test_files_of_other_formats_are_named(tmp_path: Path, name: str, what: str, advice: str) -> None:
    problem = refusal(tmp_path / name, b"\0\1\2")
    assert problem.code == "calibration_format"
    assert what in problem.message
    assert advice in str(problem.hint)


def test_archives_say_what_they_have(tmp_path: Path) -> None:
    path = tmp_path / "model.zip"
    with zipfile.ZipFile(path, "w") as archive:
        for name in ("cameras.bin", "images.bin"):
            archive.writestr(name, b"0")
    problem = refusal(path, path.read_bytes())
    assert "The archive has cameras.bin, images.bin, and no calibration" in problem.message
    assert "model_converter" in str(problem.hint)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("rig.json", b'{"frames": [], "w": 3}', "The file has the keys frames, w, and no camera"),
        ("rig.yml", b"%YAML:1.0\n---\nboard: 3\n", "The file has the keys board, and no camera"),
        ("rig.xml", b"<document><chunk/></document>", "The XML file has the root element document"),
        (
            "rig.toml",
            b"[a]\nmatrix = 3\nignore = true\n",
            "The calibration has no camera. rig.toml: camera a is left out: ignored by the file.",
        ),
    ],
)
def test_files_without_cameras_say_what_they_have(tmp_path: Path, name: str, content: bytes, message: str) -> None:
    assert refusal(tmp_path / name, content).message.startswith(message)
