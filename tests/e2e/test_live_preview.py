"""Preview of `multicap live` in a real browser: people in 3D, latency, and a camera that is lost."""

import re
import threading
import time
from dataclasses import replace

import pytest
from playwright.sync_api import expect

from api.cli.live.preview import PreviewPage
from pipeline.run.live.cameras.totals import CameraTotals, LiveTotals
from pipeline.run.live.capture import LiveCapture
from pipeline.run.live.records import recorded_frames
from pipeline.run.live.settings import LiveSettings
from pipeline.validation.simulation.scenes import SCENES, record
from tests.e2e.browsing import axe_findings, opened
from tests.e2e.test_live_page import num_bright


@pytest.mark.slow
def test_people_move_in_page() -> None:
    room = record(replace(SCENES["room"], duration_s=1.0), 0, 3)
    capture = LiveCapture(room.cameras, room.joints, LiveSettings(25.0))
    frames = recorded_frames(room.cameras, room.times, room.detections)
    instants = [instant for frame in frames for instant in capture.push(*frame)]
    totals = LiveTotals([CameraTotals("cam_00", decoded=25, detected=20), CameraTotals("cam_01", "lost", lost=1)])
    is_over = threading.Event()

    def play(preview: PreviewPage) -> None:
        preview.begin(room.cameras, room.joints, 25.0)
        while not is_over.is_set():
            for instant in instants[5:]:
                preview.show(instant, 0.08)
                time.sleep(0.02)
            totals.duration_s += 1.0
            totals.cameras[0].decoded += 25
            preview.tick(totals)

    with PreviewPage(0) as preview:
        player = threading.Thread(target=play, args=[preview])
        player.start()
        try:
            with opened(preview.url) as page:
                stage = page.locator(".live-stage")
                expect(stage).to_have_attribute("data-people", "3")
                expect(page.get_by_text("80 ms, 95 % within 80 ms")).to_be_visible()
                expect(page.get_by_role("row", name=re.compile("cam_00 open"))).to_contain_text("25 Hz")
                expect(page.get_by_role("row", name=re.compile("cam_01 lost, opening again"))).to_be_visible()
                assert num_bright(stage.screenshot()) > 500
                assert axe_findings(page) == []
        finally:
            is_over.set()
            player.join()
