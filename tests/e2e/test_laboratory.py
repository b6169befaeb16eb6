"""C3D file of a laboratory beside keypoints in the page's form."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from playwright.sync_api import expect

from pipeline.validation.simulation.motion.script import Gesture
from pipeline.validation.simulation.scenes import find_scene, record
from tests.api.web.sessions.test_keypoint_programs import parts
from tests.e2e.browsing import axe_findings, opened
from tests.e2e.serving import Served
from tests.pipeline.keypoint_programs import keypoint_files
from tests.pipeline.motion.gait.walks import exercise
from tests.pipeline.motion.laboratory.simulated_plates import c3d_bytes, plates_m, simulated

pytestmark = pytest.mark.xdist_group("page")


def write_capture(folder: Path) -> list[Path]:
    """Keypoints, timestamps and calibration of a scene, and a C3D file of a force plate."""
    simulation = record(replace(find_scene("room"), duration_s=1.0), seed=4, num_views=2)
    act = exercise(Gesture.JUMP)
    files = [file for _, file in parts(simulation, keypoint_files(simulation, "AlphaPose"))]
    files.append(("trial.c3d", c3d_bytes(simulated(act, 0.0, 1.0, plates_m(act, ((0.2, 0.0),))))))
    for name, content in files:
        (folder / name).write_bytes(content)
    return [folder / name for name, _ in files]


def test_file_beside_keypoints_has_a_clock_in_the_form(served: Served, tmp_path: Path) -> None:
    with opened(f"{served.client.base_url}#/new", allowed=("422",)) as page:
        page.set_viewport_size({"width": 390, "height": 844})
        page.get_by_label("Name of the capture").fill("Jump on a plate")
        page.get_by_label("Choose files").set_input_files(write_capture(tmp_path))
        clock = page.get_by_label("The C3D file begins")
        expect(clock).to_be_visible()
        expect(page.get_by_text("force plates, channels")).to_be_visible()
        clock.select_option("By its trigger channel")
        assert axe_findings(page) == []
        assert page.evaluate("document.documentElement.scrollWidth <= 390")
        page.screenshot(path=tmp_path / "form.png", full_page=True)
        with page.expect_response("**/v1/sessions", timeout=120_000) as answered:
            page.get_by_role("button", name="Send and reconstruct").click()
        sent = json.loads(answered.value.request.post_data or "{}")
        assert sent["manifest"]["laboratory"] == {"clock": "trigger"}
        assert "laboratory" in sent
        expect(page.get_by_role("group", name="Files").get_by_text("No channel is a trigger")).to_be_visible(
            timeout=60_000
        )
        assert axe_findings(page) == []
