"""Documents of live captures: the contract and the page."""

import re
from pathlib import Path
from typing import get_args

from api.web.live.schemas import POINTS, Layout, LiveCamerasStart, LiveStart, describe_live
from pipeline.core.layouts import LAYOUTS
from pipeline.run.live.packets import InstantHead, KeypointsHead
from pipeline.run.live.settings import LiveSettings

PAGE = (Path(__file__).parents[4] / "docs/reference/live-protocol.md").read_text(encoding="utf-8")


def test_references_of_contract_lead_somewhere() -> None:
    document = describe_live()
    references = set(re.findall(r"'\$ref': '#/([^']+)'", str(document)))
    assert len(references) > 20
    for reference in references:
        node = document
        for step in reference.split("/"):
            node = node[step]


def test_layouts_are_those_of_keypoint_files() -> None:
    assert set(get_args(Layout)) == set(POINTS)
    assert {name: len(LAYOUTS[name].points) for name in POINTS} == POINTS


def test_page_names_every_choice_and_layout() -> None:
    for start in (LiveStart, LiveCamerasStart):
        assert [name for name in start.model_fields if f"`{name}`" not in PAGE and name != "type"] == []
    assert [name for name in POINTS if f"`{name}`" not in PAGE] == []


def test_start_has_settings_of_library() -> None:
    start = LiveStart(type="start", layout="coco-17", frame_rate_hz=30.0)
    assert LiveSettings(**start.settings()) == LiveSettings(30.0)


def test_heads_have_lengths_of_page() -> None:
    assert len(KeypointsHead(0, 0, 17, 1.0).encode()) == 20
    assert len(InstantHead(0, 17, 21, 1.0, 0.1, 0).encode()) == 36
    assert InstantHead(2, 17, 21, 1.0, 0.1, 0).num_bytes == 36 + 2 * (8 + 4 * (17 * 3 + 3 + 21 * 8))
