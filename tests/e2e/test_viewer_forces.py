"""Arrows of forces in the viewer and in the report: at feet that stand alone, as long as told, and switchable."""

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Page, expect

from pipeline.core.data.reconstruction import Reconstruction
from pipeline.export.quality.report import quality_report
from pipeline.export.quality.views import person_views
from pipeline.export.report import page as report_page
from pipeline.export.report.contents import embed_motion
from pipeline.export.viewer.frames import force_arrows_m
from pipeline.motion.body import installed
from tests.api.conftest import Live, running
from tests.e2e.browsing import axe_findings, opened
from tests.e2e.test_own_points_view import MOUNT
from tests.e2e.test_report import VIEWER, is_same, picture, ready
from tests.e2e.viewer_takes import quick_settings, viewer_files_of
from tests.pipeline.export.viewer.takes import walk_with_forces

LABEL = "Ground reaction forces"

# Tail and tip of each arrow of a frame; null of hidden ones.
ARROWS = """async (frame) => {
  const { Matrix4, Vector3 } = await import("/portal/vendor/three/three.module.js");
  const { view } = globalThis.viewer;
  globalThis.viewer.goTo(frame);
  const { arrows } = view.people;
  return Array.from({ length: arrows.count }, (_, number) => {
    const matrix = new Matrix4();
    arrows.getMatrixAt(number, matrix);
    return matrix.elements[0] === 0 ? null : [0, 1].map((y) => new Vector3(0, y, 0).applyMatrix4(matrix).toArray());
  });
}"""


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Live]:
    with running(quick_settings(tmp_path_factory.mktemp("forces"))) as service:
        yield service


def show(page: Page, live: Live, take: Reconstruction, arrows_m: dict[int, np.ndarray]) -> None:
    installed.install()
    job_id = live.job_id()
    live.finish(job_id, motion=viewer_files_of(take, installed.load(), arrows_m))
    page.evaluate(MOUNT, job_id)
    expect(page.locator(".look-viewer[data-ready=true]")).to_be_visible(timeout=180_000)
    page.get_by_text("Show", exact=True).click()


def switch(page: Page) -> None:
    """Switch the arrows on or off, and close the menu, which the picture would show."""
    page.get_by_text("Show", exact=True).click()
    page.get_by_label(LABEL).click()
    page.keyboard.press("Escape")
    expect(page.get_by_label(LABEL)).to_be_hidden()


def keep_picture(page: Page, name: str) -> None:
    if folder := os.environ.get("MULTICAP_PICTURES"):
        page.screenshot(path=str(Path(folder) / name))


def test_arrows_are_at_feet_that_stand(live: Live) -> None:
    take, forces = walk_with_forces()
    arrows_m, stands = force_arrows_m(forces), np.array(forces.feet.stands)
    shown = {tuple(row): frame for frame, row in enumerate(stands.tolist())}
    assert {(True, True), (True, False), (False, True)} <= shown.keys()
    with opened(str(live.client.base_url)) as page:
        show(page, live, take, {1: arrows_m})
        for feet, frame in shown.items():
            found = page.evaluate(ARROWS, frame)
            # The second person's forces are unknown.
            assert [ends is not None for ends in found] == [*feet, False, False]
            for foot, ends in enumerate(found):
                if ends is not None:
                    np.testing.assert_allclose(ends, arrows_m[frame, 2 * foot : 2 * foot + 2], atol=2e-4)
        keep_picture(page, "forces.png")
        assert not axe_findings(page, ".look-sheet")
        page.get_by_label(LABEL).uncheck()
        assert page.evaluate(ARROWS, shown[True, True]) == [None] * 4
        page.get_by_label(LABEL).check()
        page.evaluate("globalThis.viewer.view.setShown(0, false)")
        assert page.evaluate(ARROWS, shown[True, True]) == [None] * 4


def test_switch_is_hidden_without_forces(live: Live) -> None:
    take, _ = walk_with_forces()
    with opened(str(live.client.base_url)) as page:
        show(page, live, take, {})
        expect(page.get_by_label("Foot contacts")).to_be_visible()
        expect(page.get_by_label(LABEL)).to_be_hidden()
        assert page.evaluate(ARROWS, 100) == [None] * 4


def test_report_draws_arrows_without_network(tmp_path: Path) -> None:
    if not VIEWER.is_file():
        pytest.skip("the report's viewer is not installed (`make setup`)")
    take, forces = walk_with_forces()
    views = person_views(take)
    metrics = quality_report(take, views)
    motion = embed_motion(take, views, metrics, arrows_m={1: force_arrows_m(forces)})
    rows = dict.fromkeys(("angles", "findings", "pictures", "notes", "settings", "versions", "inputs", "cameras"), ())
    path = tmp_path / "report.html"
    path.write_bytes(report_page.encode_page(report_page.ReportContents("walk", motion, metrics, **rows)))
    with opened(path.as_uri()) as page:
        ready(page)
        keep_picture(page, "forces_report.png")
        with_arrows = picture(page)
        switch(page)
        assert not is_same(picture(page), with_arrows)
        switch(page)
        assert is_same(picture(page), with_arrows)
