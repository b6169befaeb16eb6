import numpy as np
import pytest

from pipeline.capture.pairing import pair_by_name
from pipeline.data.cameras import Camera
from pipeline.geometry.rigid import Rigid3


def camera(name: str, section: str = "") -> Camera:
    return Camera(name, (640, 480), np.eye(3), np.empty(0), Rigid3(np.eye(3), np.zeros(3)), section)


CAMERAS = [camera("left", "cam_0"), camera("right", "cam_1")]


@pytest.mark.parametrize("names", [["left", "right"], ["cam_0", "cam_1"], ["cam_0", "right"]])
def test_a_name_is_the_cameras_or_its_sections(names: list[str]) -> None:
    assert pair_by_name(CAMERAS, names, "video") == (dict(zip(["left", "right"], names, strict=True)), [], [])


def test_a_name_goes_before_a_section() -> None:
    swapped = [camera("cam_1", "cam_0"), camera("cam_0", "cam_1")]
    assert pair_by_name(swapped, ["cam_0", "cam_1"], "video")[0] == {"cam_0": "cam_0", "cam_1": "cam_1"}


def test_never_half_by_name_and_half_by_order() -> None:
    pairs, problems, findings = pair_by_name(CAMERAS, ["cam_0", "b"], "video")
    assert (pairs, findings) == ({"left": "cam_0"}, [])
    assert [(one.code, one.camera or one.file) for one in problems] == [
        ("camera_without_video", "right"),
        ("video_without_camera", "b"),
    ]
    pairs, problems, findings = pair_by_name(CAMERAS, ["b", "a"], "video")
    assert (pairs, problems) == ({"left": "a", "right": "b"}, [])
    assert "left: a, right: b" in findings[0].message


def test_two_of_one_camera() -> None:
    _, problems, _ = pair_by_name(CAMERAS, ["left", "cam_0", "right"], "folder")
    assert [(one.code, one.file) for one in problems] == [("camera_with_two_folders", "left")]


def test_cameras_without_input_are_left_out_if_two_have_one() -> None:
    cameras = [*CAMERAS, *(camera(f"ceiling {k:02}") for k in range(20))]
    pairs, problems, (finding,) = pair_by_name(cameras, ["right", "left"], "folder")
    assert (pairs, problems) == ({"left": "left", "right": "right"}, [])
    assert finding.message.startswith("20 cameras of the calibration have no folder: ceiling 00, ceiling 01,")
    assert finding.message.endswith("ceiling 11, .... They are left out.")


def test_a_required_camera_is_not_left_out() -> None:
    cameras = [*CAMERAS, camera("ceiling"), camera("door")]
    _, problems, (finding,) = pair_by_name(cameras, ["left", "right"], "video", required={"door"})
    assert [(one.code, one.camera) for one in problems] == [("camera_without_video", "door")]
    assert "ceiling" in finding.message
    assert "door" not in finding.message


def test_one_pair_is_not_enough() -> None:
    _, problems, findings = pair_by_name(CAMERAS, ["left"], "video")
    assert ([(one.code, one.camera) for one in problems], findings) == ([("camera_without_video", "right")], [])
