import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.capture.names import cameras_in_names, natural_key, nfc, words
from pipeline.capture.parts import group_parts

NAMES = st.lists(
    st.text(max_size=12) | st.from_regex(r"(cam|GX|part)[ _]?[0-9]{1,6}", fullmatch=True), max_size=6, unique_by=nfc
)

# Also the cases of the page, see tests/api/portal/send.
CASES = json.loads((Path(__file__).parent / "pairing_cases.json").read_text())


@pytest.mark.parametrize("case", CASES, ids=[case["about"] for case in CASES])
def test_cameras_in_names(case: dict[str, Any]) -> None:
    found = cameras_in_names(case["names"], {camera: [] for camera in case["cameras"]})
    assert [list(found[name]) for name in case["names"]] == case["found"]


def test_second_names_count_unless_first_of_another() -> None:
    cameras = {"left": ["cam_0"], "cam_0": ["cam_1"], "door": [""]}
    assert cameras_in_names(["w_left", "w_cam_0", "w_cam_1"], cameras) == {
        "w_left": ("left",),
        "w_cam_0": ("cam_0",),
        "w_cam_1": ("cam_0",),
    }


def test_natural_order() -> None:
    names = ["cam", "cam1", "Cam2", "cam02b", "cam10", "cam11", "left", "Left 2"]
    assert sorted([*names[4:], *names[:4]], key=natural_key) == names


@given(NAMES)
def test_camera_s_own_name_is_its_own(cameras: list[str]) -> None:
    found = cameras_in_names(cameras, {camera: [] for camera in cameras})
    assert found == {camera: (camera,) for camera in cameras}


@given(NAMES, st.sampled_from(["walk", "7.2", "Éa"]), st.sampled_from("_- ."))
def test_words_around_single_camera_s_name_change_nothing(cameras: list[str], word: str, separator: str) -> None:
    for camera in cameras:
        name = separator.join([word, camera, word])
        has_words = bool(words(camera))
        assert (camera in cameras_in_names([name], {camera: []})[name]) == has_words


@given(NAMES)
def test_each_file_is_in_one_recording(names: list[str]) -> None:
    assert sorted(name for recording in group_parts(names) for name in recording) == sorted(names)
