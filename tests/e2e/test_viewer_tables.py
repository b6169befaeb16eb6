"""Tables and plots of the viewer in a real browser: gait, movements, measured clocks."""

import re
from collections.abc import Iterator

import numpy as np
import pytest
from playwright.sync_api import expect

from pipeline.core.data.cameras import Timebase
from pipeline.motion.gait.analysis import gait_document, movement_documents
from pipeline.validation.simulation.motion.script import Gesture
from tests.api.conftest import running
from tests.e2e.browsing import opened
from tests.e2e.viewer_pages import NUM_FRAMES, RATE_HZ, Shown
from tests.e2e.viewer_takes import crowd, quick_settings, viewer_files_of
from tests.pipeline.motion.gait.walks import exercise, gait_of, walk


@pytest.fixture
def shown(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shown]:
    with running(quick_settings(tmp_path_factory.mktemp("viewer"))) as live:
        job_id = live.job_id()
        live.finish(job_id, motion=viewer_files_of(crowd(1, NUM_FRAMES, float(RATE_HZ))))
        with opened(str(live.client.base_url)) as page:
            yield Shown(page, live, [job_id])


def test_gait_and_movements_are_shown_where_there_are_some(shown: Shown) -> None:
    shown.mount()
    expect(shown.page.get_by_role("tab", name="Gait and movement")).to_have_count(0)
    jumps = movement_documents(gait_of(exercise(Gesture.COUNTERMOVEMENT_JUMP)), Timebase(0.0, 60.0, 480))
    shown.mount(person={"gait": gait_document(gait_of(walk(1.2))), "movements": jumps})
    shown.page.get_by_role("tab", name="Gait and movement").click()
    gait = shown.page.get_by_role("table", name="Gait")
    expect(gait.get_by_role("row")).to_have_count(4)
    expect(gait.get_by_role("row").nth(1)).to_contain_text("steps/min")
    movements = shown.page.get_by_role("table", name="Movements")
    expect(movements.get_by_role("row")).to_have_count(1 + len(jumps))
    button = movements.get_by_role("button").first
    frame = int(button.text_content() or "")
    button.click()
    assert shown.frame == min(frame, NUM_FRAMES - 1)


def test_measured_clocks_are_shown_with_their_evidence(shown: Shown) -> None:
    shown.mount()
    expect(shown.page.get_by_role("tab", name="Clocks")).to_have_count(0)
    offsets_s = np.arange(-50, 51) / 20
    found = (("a", 0.0, 1.0, None), ("b", 0.48, 1.0 - 2e-5, 0.0021))
    clocks = [
        {
            "camera": name, "offset_s": offset_s, "rate": rate, "sigma_s": sigma_s,
            "offsets_s": (offsets_s + offset_s).tolist(), "disagreement": (1 - np.exp(-(offsets_s**2))).tolist(),
        }
        for name, offset_s, rate, sigma_s in found
    ]  # fmt: skip
    shown.mount(clocks=clocks)
    shown.page.get_by_role("tab", name="Clocks").click()
    expect(shown.page.get_by_text("b starts at 0.480 s ± 2.1 ms, clock fast by 20.0 ppm")).to_be_visible()
    expect(shown.page.get_by_text("a starts at 0.000 s, standard deviation unknown")).to_be_visible()
    curve = shown.page.get_by_role("img", name="b: disagreement over the offset")
    # The valley of the curve is under the mark of the offset that was found.
    points = curve.locator(".look-curve").get_attribute("d") or ""
    x_px, _ = max((point.split(",") for point in re.split("[ML]", points)[1:]), key=lambda point: float(point[1]))
    mark = curve.locator(".look-found")
    middle_px = float(mark.get_attribute("x") or 0) + float(mark.get_attribute("width") or 0) / 2
    assert float(x_px) == pytest.approx(middle_px, abs=1.0)
    assert points.count("M") == 1
