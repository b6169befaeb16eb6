"""The report in Chromium, from a file without a network: strangers' names are inert, and everything works."""

from dataclasses import replace
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from playwright.sync_api import Page, expect

from pipeline.capture.keypoints import KeypointSession, open_keypoints
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.options.edits import Cut, Rename
from pipeline.export.report import page as report_page
from pipeline.motion.body import installed
from pipeline.run.engine.local import reconstruct_to_files
from tests.cases import slow_but
from tests.e2e.browsing import axe_findings, opened
from tests.e2e.captures import keypoint_capture
from tests.e2e.foreign import READERS

VIEWER = Path(report_page.__file__).parent / "assets" / "viewer.js"
POLICY = "Content Security Policy"
HOSTILE = "</script><img src=x onerror=document.title='taken'>\"'&"


def renamed(session: KeypointSession) -> KeypointSession:
    """Session whose first camera has a hostile name, which no reader of calibrations lets through."""
    old = session.cameras[0].name

    def new(name: str) -> str:
        return HOSTILE if name == old else name

    return replace(
        session,
        cameras=tuple(replace(camera, name=new(camera.name)) for camera in session.cameras),
        times={new(name): times for name, times in session.times.items()},
        detections={new(name): replace(found, camera=new(name)) for name, found in session.detections.items()},
        folders={new(name): folder for name, folder in session.folders.items()},
    )


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Report of simulated people, of whom one has a hostile name too, as the take and a file have."""
    if not VIEWER.is_file():
        pytest.skip("the report's viewer is not installed (`make setup`)")
    installed.install()
    folder = tmp_path_factory.mktemp("capture")
    keypoint_capture(folder)
    session = open_keypoints(folder / "keypoints", folder / "calibration.json", folder / "timestamps.csv")
    source = folder / "b<b>old.csv"
    source.write_text("", encoding="utf-8")
    config = ReconstructionConfig(
        report=True, edits=(Rename(person=1, name=HOSTILE), Cut(start_frame=5, stop_frame=45))
    )
    written = reconstruct_to_files(renamed(session), folder, config, name=HOSTILE, sources=[source])
    assert written.paths[0] == folder / "report.html"
    return folder / "report.html"


def test_report_from_file_plays_without_network(report: Path) -> None:
    requests: list[str] = []
    with opened(report.as_uri()) as page:
        page.on("request", lambda request: requests.append(request.url))
        page.reload()
        ready(page)
        head, clock = page.get_by_label("Play head"), page.locator(".look-where")
        # The middle of the people's frames; the edit has cut 40 frames.
        assert (head.get_attribute("max"), head.input_value()) == ("39", "20")
        before = picture(page)
        page.locator("canvas.look-canvas").press("Home")
        assert clock.inner_text().endswith("frame 0 of 40 (5 of the source)")
        assert not is_same(picture(page), before)
        page.locator("canvas.look-canvas").press("Shift+ArrowRight")
        assert clock.inner_text().endswith("frame 10 of 40 (15 of the source)")
        page.keyboard.press("Space")
        expect(clock).to_contain_text("frame 39 of 40")
        expect(page.locator(".look-play")).to_have_attribute("aria-label", "Play (Space)")
        strip = page.locator(".look-strip").first
        width = strip.evaluate("canvas => canvas.clientWidth")
        strip.click(position={"x": width * 10.5 / 40, "y": 5})
        assert clock.inner_text().endswith("frame 10 of 40 (15 of the source)")
        orbited = picture(page)
        page.locator(".look-view").scroll_into_view_if_needed()
        scene = page.locator(".look-view").bounding_box()
        assert scene is not None
        page.mouse.move(scene["x"] + 200, scene["y"] + 200)
        page.mouse.down()
        page.mouse.move(scene["x"] + 300, scene["y"] + 180)
        page.mouse.up()
        assert not is_same(picture(page), orbited)
        page.get_by_role("combobox", name="View").select_option(index=1)
        assert not is_same(picture(page), orbited)
        page.get_by_role("button", name="Show frame").first.click()
        assert not clock.inner_text().endswith("frame 10 of 40 (15 of the source)")
    assert requests == [report.as_uri()]


def test_bodies_are_humans_or_capsules(report: Path) -> None:
    with opened(report.as_uri()) as page:
        ready(page)
        page.get_by_text("Show", exact=True).click()
        bodies = page.get_by_label("Bodies as")
        assert bodies.input_value() == "human"
        humans = picture(page)
        bodies.select_option("capsule")
        assert not is_same(picture(page), humans)
        bodies.select_option("human")
        assert is_same(picture(page), humans)


def ready(page: Page) -> None:
    page.locator("[data-ready=true]").wait_for()
    settled(page)


def settled(page: Page) -> None:
    """Wait until the view is at rest, drawn with all its pixels."""
    page.wait_for_timeout(700)


def picture(page: Page) -> NDArray[np.uint8]:
    """Picture of the 3D view, once it is at rest and nothing in it has the focus."""
    page.evaluate("document.activeElement.blur()")
    settled(page)
    shown = cv2.imdecode(np.frombuffer(page.locator(".look-view").screenshot(), np.uint8), cv2.IMREAD_COLOR)
    assert shown is not None
    return shown.astype(np.uint8)


def is_same(one: NDArray[np.uint8], other: NDArray[np.uint8]) -> bool:
    """Tell whether two pictures show the same; between two drawings Chromium shades single pixels differently."""
    return bool((cv2.absdiff(one, other) > 8).sum() < 20)


def test_names_of_strangers_are_text(report: Path) -> None:
    with opened(report.as_uri(), allowed=(POLICY,)) as page:
        assert page.title() == f"{HOSTILE}, report"
        assert page.locator("h1").inner_text() == HOSTILE
        assert page.locator(".look-line .look-ellipsis").first.inner_text() == HOSTILE
        assert page.get_by_role("combobox", name="View").locator("option").nth(1).inner_text() == f"Through {HOSTILE}"
        assert page.get_by_role("rowheader", name="b<b>old.csv").count() == 1
        # Pictures of the cameras alone, and the scripts of the report alone.
        assert page.locator("img:not([src^='data:image/jpeg'])").count() == 0
        assert page.locator("script").count() == 2
        # Something that did get in could not run.
        with page.expect_console_message(lambda message: POLICY in message.text):
            page.evaluate("""document.body.insertAdjacentHTML('beforeend', '<p onclick="document.title = 1">x</p>');
              document.body.lastElementChild.click()""")
        assert page.title() == f"{HOSTILE}, report"


@pytest.mark.parametrize(("width", "scheme"), slow_but([(390, "dark")], [(1280, "light"), (390, "dark")]))
def test_report_is_accessible_and_fits(report: Path, width: int, scheme: Literal["light", "dark"]) -> None:
    if not (READERS / "node_modules/axe-core").is_dir():
        pytest.skip("axe-core is not installed (`npm ci` in tests/e2e/readers)")
    with opened(report.as_uri(), {"width": width, "height": 844}) as page:
        page.emulate_media(color_scheme=scheme)
        assert axe_findings(page) == []
        assert page.evaluate("document.documentElement.scrollWidth") == width


def test_report_shows_edited_take(report: Path) -> None:
    text = report.read_text(encoding="utf-8")
    assert "40 frames at" in text
    assert "start frame 5" in text
    assert len(text) < 1_500_000
