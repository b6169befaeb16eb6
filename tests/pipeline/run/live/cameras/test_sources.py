"""Sources of cameras as users state them."""

from pathlib import Path

import pytest

from pipeline.core.errors import InputError
from pipeline.core.problems.finding_codes import CAMERA_SOURCE
from pipeline.core.problems.session_codes import VIDEO_MISSING
from pipeline.run.live.cameras.sources import CameraSource, find_devices, read_sources


def test_kinds_of_sources(tmp_path: Path) -> None:
    clip = tmp_path / "a=b.mp4"
    clip.touch()
    texts = ["a=rtsp://user:secret@camera/1?token=x", "b = HTTPS://camera:8080/video", f"c={clip}", "d=/dev/null"]
    sources = read_sources(texts, ["a", "b", "c", "d"])
    assert [(source.kind, source.shown) for source in sources] == [
        ("rtsp", "rtsp://camera/1"),
        ("http", "https://camera:8080/video"),
        ("file", "a=b.mp4"),
        ("device", "null"),
    ]


def test_everything_that_is_wrong_is_said_at_once() -> None:
    texts = ["clip.mp4", "a=gone.mp4", "z=rtsp://camera", "a=ftp://camera", "b=/dev/video99", "=x"]
    with pytest.raises(InputError) as error:
        read_sources(texts, ["a", "b"])
    found = [(problem.code, problem.camera) for problem in error.value.problems]
    assert found == [
        (CAMERA_SOURCE, None),
        (VIDEO_MISSING, "a"),
        (CAMERA_SOURCE, "z"),
        (CAMERA_SOURCE, "a"),  # twice
        (CAMERA_SOURCE, "a"),  # ftp
        (VIDEO_MISSING, "b"),
        (CAMERA_SOURCE, None),
    ]
    assert all(problem.hint for problem in error.value.problems)


def test_source_of_another_camera_is_refused() -> None:
    with pytest.raises(InputError, match="another camera's already") as error:
        read_sources(["a=rtsp://camera", "b=rtsp://camera"], ["a", "b"])
    assert [(problem.code, problem.camera) for problem in error.value.problems] == [(CAMERA_SOURCE, "b")]


def test_one_camera_is_not_enough() -> None:
    with pytest.raises(InputError, match="at least two"):
        read_sources(["a=rtsp://camera"], ["a", "b"])
    assert CameraSource("a", "rtsp", "rtsp://camera").shown == "rtsp://camera"


def test_devices_of_machine_have_names(tmp_path: Path) -> None:
    for device, index, name in [("video0", "0\n", "HD Webcam\n"), ("video1", "1\n", "HD Webcam\n"), ("video2", "", "")]:
        (tmp_path / device).mkdir()
        (tmp_path / device / "index").write_text(index)
        (tmp_path / device / "name").write_text(name)
    assert find_devices(tmp_path) == {"/dev/video0": "HD Webcam"}
    assert find_devices(tmp_path / "none") == {}
