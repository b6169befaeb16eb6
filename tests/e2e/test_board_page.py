"""Page of the calibration board: what is on the full screen, and what is printed, is the board that it names."""

import re
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from playwright.sync_api import Page, expect

from pipeline.calibration.board.corner_search.find_board import find_board
from pipeline.calibration.board.spec import parse_board
from tests.e2e.browsing import axe_findings, opened
from tests.e2e.serving import Served

# The tests of the page share a service.
pytestmark = pytest.mark.xdist_group("page")

MM_PER_INCH, POINTS_PER_INCH = 25.4, 72.0


@pytest.fixture
def page(served: Served) -> Iterator[Page]:
    with opened(f"{served.client.base_url}/portal/record/board.html") as page:
        yield page


def test_board_on_screen_is_found_at_stated_size(page: Page) -> None:
    # A screen of 4 pixels a millimetre.
    page.get_by_label("Size of the frame").evaluate(
        "(field) => { field.value = '4'; field.dispatchEvent(new Event('input')); }"
    )
    card = page.get_by_role("img", name="Frame of a bank card").bounding_box()
    assert card is not None
    assert card["width"] / 4 == pytest.approx(85.6, abs=0.1)
    assert card["height"] / 4 == pytest.approx(53.98, abs=0.1)
    page.get_by_role("button", name="Show full screen").click()
    expect(page.locator(".board-full")).to_be_visible()
    picture = cv2.imdecode(np.frombuffer(page.screenshot(), np.uint8), cv2.IMREAD_COLOR)
    page.locator(".board-full").click()
    name = page.locator(".board-name").inner_text()
    assert picture is not None
    board = find_board(np.asarray(picture, np.uint8), parse_board(name))
    assert board is not None
    assert board.num_found == 6 * 4
    side_px = float(np.linalg.norm(board.corners_px[5] - board.corners_px[0])) / 5
    assert side_px / 4 == pytest.approx(1000 * float(name.split(":")[2]), abs=0.05)
    assert axe_findings(page) == []


def test_printed_board_has_squares_of_stated_size(page: Page, tmp_path: Path) -> None:
    page.evaluate("window.print = () => {}")
    page.get_by_role("button", name=re.compile("A4")).click()
    expect(page.locator(".board-name")).to_have_text("charuco:7x5:0.036:0.027:DICT_4X4_50")
    content = page.pdf(prefer_css_page_size=True)
    (width, height) = next(iter(re.findall(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", content)))
    size_mm = [float(value) * MM_PER_INCH / POINTS_PER_INCH for value in (width, height)]
    assert size_mm == pytest.approx([297, 210], abs=1)
    page.emulate_media(media="print")
    drawn = page.get_by_role("img", name="Board for A4", include_hidden=True).bounding_box()
    assert drawn is not None
    # 96 pixels an inch; half a square of white is around the board.
    assert drawn["width"] * MM_PER_INCH / 96 == pytest.approx(8 * 36, abs=0.5)
    assert drawn["height"] * MM_PER_INCH / 96 == pytest.approx(6 * 36, abs=0.5)
