import numpy as np
import pytest

from pipeline.capture.pairing import pair
from pipeline.core.data.cameras import Camera
from pipeline.core.data.rigid import Rigid3


def camera(name: str, section: str = "") -> Camera:
    return Camera(name, (640, 480), np.eye(3), np.empty(0), Rigid3(np.eye(3), np.zeros(3)), section)


CAMERAS = [camera("left", "cam_0"), camera("right", "cam_1")]


@pytest.mark.parametrize("names", [["left", "right"], ["cam_0", "cam_1"], ["cam_0", "right"]])
def test_name_is_cameras_or_its_sections(names: list[str]) -> None:
    assert pair(CAMERAS, names, "video") == (dict(zip(["left", "right"], names, strict=True)), [], [])


def test_name_goes_before_section() -> None:
    swapped = [camera("cam_1", "cam_0"), camera("cam_0", "cam_1")]
    assert pair(swapped, ["cam_0", "cam_1"], "video")[0] == {"cam_0": "cam_0", "cam_1": "cam_1"}


def test_never_half_by_name_and_half_by_order() -> None:
    pairs, problems, findings = pair(CAMERAS, ["cam_0", "b"], "video")
    assert (pairs, findings) == ({"left": "cam_0"}, [])
    assert [(problem.code, problem.camera or problem.file) for problem in problems] == [
        ("camera_without_video", "right"),
        ("video_without_camera", "b"),
    ]
    pairs, problems, findings = pair(CAMERAS, ["b", "a"], "video", by_order=True)
    assert (pairs, problems) == ({"left": "a", "right": "b"}, [])
    assert "left: a, right: b" in findings[0].message


def test_order_counts_only_if_it_is_asked_for() -> None:
    pairs, (problem,), findings = pair(CAMERAS, ["b", "a"], "folder")
    assert (pairs, problem.code, findings) == ({}, "pairing_unknown", [])
    assert problem.hint is not None
    assert problem.hint.startswith("The cameras are left, right; the folders are a, b.")
    _, (problem,), _ = pair(CAMERAS, ["c", "b", "a"], "video", by_order=True)
    assert problem.code == "pairing_counts"
    assert problem.hint == "The cameras are left, right; the videos are a, b, c."


@pytest.mark.parametrize("pattern", ["video{:02}", "{}", "take 3, {}th"])
def test_eleven_cameras_in_alphabetical_order(pattern: str) -> None:
    """A calibration has them as cam1, cam10, cam11, cam2: each would have got the video of another."""
    cameras = [camera(name) for name in sorted(f"cam{k}" for k in range(1, 12))]
    names = [pattern.format(k) for k in range(1, 12)]
    _, (problem,), _ = pair(cameras, names, "video")
    assert problem.code == "pairing_unknown"
    pairs, problems, _ = pair(cameras, names, "video", by_order=True)
    assert (pairs, problems) == ({f"cam{k}": pattern.format(k) for k in range(1, 12)}, [])


def test_ambiguous_name_is_refused_with_both_lists() -> None:
    _, problems, _ = pair(CAMERAS, ["left_right_1", "right_2"], "video")
    assert [(problem.code, problem.camera or problem.file) for problem in problems] == [
        ("camera_without_video", "left"),
        ("pairing_ambiguous", "left_right_1"),
    ]
    assert "left, right; the videos are left_right_1, right_2." in str(problems[1].hint)


def test_stated_pairs_go_before_names_and_order() -> None:
    stated = {"left": "right"}
    assert pair(CAMERAS, ["cam_1"], "video", stated) == ({"left": "right", "right": "cam_1"}, [], [])
    assert pair(CAMERAS, ["b"], "video", stated, by_order=True).pairs == {"left": "right", "right": "b"}
    _, problems, _ = pair(CAMERAS, ["walk left"], "video", stated)
    assert [(problem.code, problem.camera) for problem in problems] == [
        ("camera_without_video", "right"),
        ("camera_with_two_videos", "left"),
    ]


def test_two_of_one_camera() -> None:
    _, problems, _ = pair(CAMERAS, ["left", "cam_0", "right"], "folder")
    assert [(one.code, one.file) for one in problems] == [("camera_with_two_folders", "left")]


def test_cameras_without_input_are_left_out_if_two_have_one() -> None:
    cameras = [*CAMERAS, *(camera(f"ceiling {k:02}") for k in range(20))]
    pairs, problems, (finding,) = pair(cameras, ["right", "left"], "folder")
    assert (pairs, problems) == ({"left": "left", "right": "right"}, [])
    assert finding.message.startswith("20 cameras of the calibration have no folder: ceiling 00, ceiling 01,")
    assert finding.message.endswith("ceiling 11, .... They are left out.")


def test_required_camera_is_not_left_out() -> None:
    cameras = [*CAMERAS, camera("ceiling"), camera("door")]
    _, problems, (finding,) = pair(cameras, ["left", "right"], "video", required={"door"})
    assert [(one.code, one.camera) for one in problems] == [("camera_without_video", "door")]
    assert "ceiling" in finding.message
    assert "door" not in finding.message


def test_one_pair_is_not_enough() -> None:
    _, problems, findings = pair(CAMERAS, ["left"], "video")
    assert ([(one.code, one.camera) for one in problems], findings) == ([("camera_without_video", "right")], [])
