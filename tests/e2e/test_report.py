"""The report in Chromium, from a file without a network: strangers' names are inert, and everything works."""

from dataclasses import replace
from pathlib import Path
from typing import Literal

import pytest
from playwright.sync_api import Page, expect

from pipeline.capture.keypoints import KeypointSession, open_keypoints
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.options.edits import Cut, Rename
from pipeline.motion.body import installed
from pipeline.run.engine.local import reconstruct_to_files
from tests.cases import slow_but
from tests.e2e.browsing import axe_findings, opened
from tests.e2e.captures import keypoint_capture
from tests.e2e.foreign import READERS

# Number of bright colours that many pixels of the 3D view have.
SHADES = """() => {
  const scene = document.getElementById("scene");
  const sheet = Object.assign(document.createElement("canvas"), { width: scene.width, height: scene.height });
  const context = sheet.getContext("2d", { willReadFrequently: true });
  context.drawImage(scene, 0, 0);
  const { data } = context.getImageData(0, 0, sheet.width, sheet.height);
  const count = {};
  for (let place = 0; place < data.length; place += 4) {
    const rgb = data.slice(place, place + 3);
    if (Math.max(...rgb) - Math.min(...rgb) > 60) count[rgb] = (count[rgb] ?? 0) + 1;
  }
  return Object.values(count).filter((number) => number > 20).length;
}"""
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


def test_it_works_from_a_file_and_asks_nobody(report: Path) -> None:
    requests: list[str] = []
    with opened(report.as_uri()) as page:
        page.on("request", lambda request: requests.append(request.url))
        page.reload()
        # The middle of the people's frames; the edit has cut 40 frames.
        assert page.locator("#head").get_attribute("max") == "39"
        before = picture(page)
        page.locator("#scene").press("Home")
        assert page.locator("#clock").inner_text().endswith("frame 0 (5 of the source)")
        assert picture(page) != before
        page.locator("#scene").press("Shift+ArrowRight")
        assert page.locator("#clock").inner_text().endswith("frame 10 (15 of the source)")
        page.keyboard.press("Space")
        expect(page.locator("#clock")).to_contain_text("frame 39")
        expect(page.locator("#play")).to_have_text("Play")
        strip = page.locator(".strip canvas").first
        width = strip.evaluate("canvas => canvas.clientWidth")
        strip.click(position={"x": width * 10.5 / 40, "y": 5})
        assert page.locator("#clock").inner_text().endswith("frame 10 (15 of the source)")
        orbited = picture(page)
        page.locator("#scene").scroll_into_view_if_needed()
        scene = page.locator("#scene").bounding_box()
        assert scene is not None
        page.mouse.move(scene["x"] + 200, scene["y"] + 200)
        page.mouse.down()
        page.mouse.move(scene["x"] + 300, scene["y"] + 180)
        page.mouse.up()
        assert picture(page) != orbited
        page.locator("#view").select_option(index=1)
        assert picture(page) != orbited
    assert requests == [report.as_uri()]


def test_people_are_humans_or_limbs(report: Path) -> None:
    with opened(report.as_uri()) as page:
        choice = page.get_by_label("Humans")
        expect(choice).to_be_checked()
        humans, shades = picture(page), page.evaluate(SHADES)
        choice.uncheck()
        assert picture(page) != humans
        # Limbs have one colour, humans light and shadow.
        assert page.evaluate(SHADES) < shades / 2
        choice.check()
        assert picture(page) == humans


def picture(page: Page) -> str:
    """What the 3D view shows."""
    return str(page.evaluate("document.getElementById('scene').toDataURL()"))


def test_names_of_strangers_are_text(report: Path) -> None:
    with opened(report.as_uri(), allowed=(POLICY,)) as page:
        assert page.title() == f"{HOSTILE}, report"
        assert page.locator("h1").inner_text() == HOSTILE
        assert page.locator(".who").first.inner_text() == HOSTILE
        assert page.locator("#view option").nth(1).inner_text() == HOSTILE
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
def test_it_is_accessible_and_fits(report: Path, width: int, scheme: Literal["light", "dark"]) -> None:
    if not (READERS / "node_modules/axe-core").is_dir():
        pytest.skip("axe-core is not installed (`npm ci` in tests/e2e/readers)")
    with opened(report.as_uri(), {"width": width, "height": 844}) as page:
        page.emulate_media(color_scheme=scheme)
        assert axe_findings(page) == []
        assert page.evaluate("document.documentElement.scrollWidth") == width


def test_it_is_of_the_edited_take(report: Path) -> None:
    text = report.read_text(encoding="utf-8")
    assert "40 frames at" in text
    assert "start frame 5" in text
    assert len(text) < 1_000_000
