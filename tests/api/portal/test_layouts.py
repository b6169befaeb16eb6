"""Layouts of keypoints that the form offers."""

import re
from pathlib import Path

from pipeline.core.layouts import FILE_LAYOUTS

VIEW = Path(__file__).parents[3] / "api/portal/send/view.js"


def test_form_offers_layouts_of_files() -> None:
    (names,) = re.findall(r"const LAYOUTS = \[([^\]]*)\]", VIEW.read_text("utf-8"))
    assert set(re.findall(r'"([^"]+)"', names)) == set(FILE_LAYOUTS)
