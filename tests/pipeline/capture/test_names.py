import json
from pathlib import Path
from typing import Any

import pytest

from pipeline.capture.names import cameras_in_names, natural_key

# Also the cases of the page, see tests/api/portal/send.
CASES = json.loads((Path(__file__).parent / "pairing_cases.json").read_text())


@pytest.mark.parametrize("case", CASES, ids=[case["about"] for case in CASES])
def test_cameras_in_names(case: dict[str, Any]) -> None:
    found = cameras_in_names(case["names"], {camera: [] for camera in case["cameras"]})
    assert [list(found[name]) for name in case["names"]] == case["found"]


def test_second_names_count_unless_they_are_another_camera_s_first() -> None:
    cameras = {"left": ["cam_0"], "cam_0": ["cam_1"], "door": [""]}
    assert cameras_in_names(["w_left", "w_cam_0", "w_cam_1"], cameras) == {
        "w_left": ("left",),
        "w_cam_0": ("cam_0",),
        "w_cam_1": ("cam_0",),
    }


def test_natural_order() -> None:
    names = ["cam", "cam1", "Cam2", "cam02b", "cam10", "cam11", "left", "Left 2"]
    assert sorted([*names[4:], *names[:4]], key=natural_key) == names
