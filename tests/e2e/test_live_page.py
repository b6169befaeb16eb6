"""View Live in a real browser: dropped keypoints go over the WebSocket, and people with skeletons come back."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from playwright.sync_api import expect

from tests.e2e.browsing import axe_findings, opened
from tests.e2e.captures import keypoint_capture
from tests.e2e.serving import Served
from tests.e2e.test_serve_keypoints import archives

# The tests of the page share a service.
pytestmark = pytest.mark.xdist_group("page")


def num_bright(png: bytes) -> int:
    """Number of bright pixels of a picture."""
    picture = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    return int((picture.max(-1) > 150).sum())


@pytest.fixture(scope="module")
def take(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Files of a take of five seconds: a zip a camera, timestamps, calibration."""
    folder = tmp_path_factory.mktemp("live")
    keypoint_capture(folder, 5.0)
    for _, (name, content) in archives(folder):
        (folder / name).write_bytes(content)
    return [path for path in sorted(folder.iterdir()) if path.suffix in {".zip", ".csv", ".json"}]


def test_keypoints_in_people_out_and_session_kept(served: Served, take: list[Path]) -> None:
    received: list[str | bytes] = []

    def take_message(content: str | bytes) -> None:
        received.append(content)

    with opened(f"{served.client.base_url}#/live") as page:
        page.on("websocket", lambda socket: socket.on("framereceived", take_message))
        page.get_by_label("Keypoint files").check()
        page.get_by_role("button", name="Play live").click()
        expect(page.get_by_role("alert")).to_contain_text("Choose keypoints of the cameras.")
        page.get_by_label("Choose files").set_input_files(take)
        expect(page.get_by_text(re.compile(r"cam_00: \d+ frames"))).to_be_visible()
        expect(page.get_by_text(re.compile("cameras · "))).to_be_visible(timeout=180_000)
        page.get_by_label("Keep as a capture").check()
        page.get_by_label("Name", exact=True).fill("Seen live")
        page.get_by_role("button", name="Play live").click()
        expect(page.get_by_text(re.compile("[1-9], [1-9] with a skeleton"))).to_be_visible(timeout=180_000)
        stage = page.locator(".live-stage")
        expect(stage).to_have_attribute("data-people", re.compile("[1-9]"))
        assert num_bright(stage.screenshot()) > 500
        expect(page.get_by_text(re.compile(r"\d+ ms, 95 % within \d+ ms"))).to_be_visible()
        assert axe_findings(page) == []
        expect(page.get_by_text(re.compile("frames of .* are kept"))).to_be_visible(timeout=180_000)
        assert sum(isinstance(content, bytes) and content[:4] == b"MCI1" for content in received) > 50
        captures = page.get_by_role("link", name="a capture").get_attribute("href")
        page.get_by_role("button", name="Reconstruct it").click()
        expect(page).to_have_url(re.compile("#/jobs/"))
        expect(page.get_by_text("Done").first).to_be_visible(timeout=120_000)
        with page.expect_download() as download:
            page.get_by_role("link", name=re.compile(r"\.bvh")).first.click()
        assert download.value.path().read_text().startswith("HIERARCHY\nROOT Hips")
        page.goto(f"/{captures}")
        expect(page.get_by_role("heading", name="Seen live", level=2)).to_be_visible()
        expect(page.get_by_role("heading", level=2)).to_have_count(1)
