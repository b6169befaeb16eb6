"""Files that are written are read as the same cameras, also by the programs whose formats they are."""

import tomllib
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pipeline.calibration.program_files import PROGRAM_FORMATS
from pipeline.calibration.registry import read_contents
from pipeline.calibration.write import ENCODERS
from pipeline.core.data.cameras import Camera
from pipeline.core.data.rigid import Rigid3
from tests.pipeline.calibration.readers.rigs import RIG, assert_rig, camera, fisheye


@pytest.mark.parametrize("ending", ENCODERS)
def test_written_file_is_read_back(tmp_path: Path, ending: str) -> None:
    rig = (
        *RIG,
        camera('Kamera "1" é: #', 0.5, ()),
        camera("01", 1.0, tuple(0.01 * np.arange(12))),
        fisheye("f", 2.0),
        camera("\N{MOVIE CAMERA} 2", 0.2),
        camera("cameras", 0.1),
        camera("camera_3", 0.4),
    )
    path = tmp_path / f"rig{ending}"
    path.write_bytes(ENCODERS[ending](rig))
    assert_rig(read_contents(path), rig, num_digits=9)


@given(
    matrix=st.tuples(st.floats(1, 1e6), st.floats(-1e3, 1e3), st.floats(1, 1e6), st.floats(-1e5, 1e5)),
    turn=st.tuples(*[st.floats(-3.1, 3.1)] * 3),
    translation_m=st.tuples(*[st.floats(-1e4, 1e4)] * 3),
    distortion=st.sampled_from((0, 4, 5, 8, 12)).flatmap(
        lambda n: st.lists(st.floats(-1e3, 1e3), min_size=n, max_size=n)
    ),
    is_fisheye=st.booleans(),
    ending=st.sampled_from(sorted(ENCODERS)),
)
def test_every_camera_survives(
    tmp_path_factory: pytest.TempPathFactory,
    matrix: tuple[float, ...],
    turn: tuple[float, ...],
    translation_m: tuple[float, ...],
    distortion: list[float],
    is_fisheye: bool,
    ending: str,
) -> None:
    fx, skew, fy, cx = matrix
    written = Camera(
        "camera",
        (1920, 1080),
        np.array([[fx, skew, cx], [0.0, fy, -cx], [0.0, 0.0, 1.0]]),
        np.array(distortion),
        Rigid3(Rotation.from_rotvec(turn).as_matrix(), np.array(translation_m)),
        lens="fisheye" if is_fisheye and len(distortion) == 4 else "standard",
    )
    path = tmp_path_factory.mktemp("rig") / f"rig{ending}"
    path.write_bytes(ENCODERS[ending]([written]))
    (read,) = read_contents(path, "m").cameras
    assert (read.name, read.size_px, read.lens) == (written.name, written.size_px, written.lens)
    np.testing.assert_array_equal(read.matrix, written.matrix)
    num_coefficients = len(written.distortion)
    np.testing.assert_array_equal(read.distortion[:num_coefficients], written.distortion)
    assert not read.distortion[num_coefficients:].any()
    np.testing.assert_array_equal(read.cam_from_world.translation_m, written.cam_from_world.translation_m)
    np.testing.assert_allclose(read.cam_from_world.rotation, written.cam_from_world.rotation, atol=1e-12)


@pytest.mark.parametrize("name", ["multicap", "anipose", "caliscope", "opencv"])
def test_every_format_is_read(tmp_path: Path, name: str) -> None:
    target = PROGRAM_FORMATS[name]
    rig = (*RIG, fisheye("f", 2.0))
    path = tmp_path / f"rig{target.endings[0]}"
    path.write_bytes(target.encode(rig))
    assert_rig(read_contents(path), rig, num_digits=9)


def test_caliscope_finds_what_its_reader_looks_for(tmp_path: Path) -> None:
    """Caliscope looks under ``cameras`` for sections named by numbers, and shows five coefficients or four."""
    cameras = tomllib.loads(
        PROGRAM_FORMATS["caliscope"].encode((camera("plain", 0.1, ()), fisheye("f", 2.0))).decode()
    )["cameras"]
    assert list(cameras) == ["0", "1"]
    assert [one["cam_id"] for one in cameras.values()] == [0, 1]
    assert [len(one["distortions"]) for one in cameras.values()] == [5, 4]
    assert [one["fisheye"] for one in cameras.values()] == [False, True]
    assert all(
        len(one["rotation"]) == len(one["translation"]) == 3 and len(one["size"]) == 2 for one in cameras.values()
    )


@pytest.mark.parametrize("name", ["anipose", "caliscope", "opencv"])
def test_lens_without_distortion_has_five_zeros(name: str) -> None:
    text = PROGRAM_FORMATS[name].encode([camera("plain", 0.1, ())]).decode()
    assert text.count("0.0, 0.0, 0.0, 0.0, 0.0") == 1


def test_sections_of_anipose_are_in_order_of_cameras_as_text() -> None:
    """aniposelib sorts them: cam_10 would come before cam_2."""
    for count in (10, 11, 12, 101):
        rig = [camera(f"c{number}", 0.01 * number) for number in range(count)]
        sections = tomllib.loads(PROGRAM_FORMATS["anipose"].encode(rig).decode())
        assert [sections[title]["name"] for title in sorted(sections)] == [one.name for one in rig]
    assert list(tomllib.loads(PROGRAM_FORMATS["anipose"].encode(RIG).decode())) == ["cam_0", "cam_1"]


def test_names_that_are_no_keys_of_opencv_are_fields(tmp_path: Path) -> None:
    path = tmp_path / "rig.yml"
    rig = (camera("01", 0.1), camera("camera_0", 0.2), camera("a b", 0.3))
    path.write_bytes(ENCODERS[".yml"](rig))
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    keys = list(storage.root().keys())
    assert keys == ["camera_1", "camera_0", "camera_2"]
    assert [storage.getNode(key).getNode("name").string() for key in keys] == ["01", "", "a b"]
    storage.release()
    assert [one.section for one in read_contents(path).cameras] == ["camera_1", "", "camera_2"]


def test_opencv_reads_its_yaml(tmp_path: Path) -> None:
    path = tmp_path / "rig.yml"
    path.write_bytes(ENCODERS[".yml"](RIG))
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    node = storage.getNode("right")
    np.testing.assert_array_equal(node.getNode("camera_matrix").mat(), RIG[1].matrix)
    np.testing.assert_array_equal(node.getNode("tvec").mat().ravel(), RIG[1].cam_from_world.translation_m)
    np.testing.assert_allclose(cv2.Rodrigues(node.getNode("rvec").mat())[0], RIG[1].cam_from_world.rotation, atol=1e-12)
    assert int(node.getNode("image_width").real()) == 1920
    storage.release()
