"""Phones in trouble: refused for a while, turned while they record, with uploads that the service does not take."""

import json
import re
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page, Route, WebSocketRoute, expect

from tests.e2e.browsing import opened
from tests.e2e.datasets import folder_of, needs
from tests.e2e.phone_takes import PATIENT_MS, join, open_recording, phone_card, recording_of, start, take_card
from tests.e2e.phones import phones, write_camera
from tests.e2e.serving import Served
from tests.waiting import wait_for

pytestmark = [needs("rendered"), pytest.mark.slow, pytest.mark.real_time]

OUTAGE = {
    **{"type": "problem", "code": "database_unavailable", "detail": "The database does not answer.", "hint": None},
    **{"errors": [], "retryable": True, "close_code": 1013, "request_id": "0"},
}
REASON = "The clip is larger than this service takes."


@pytest.fixture(scope="module")
def camera(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, Path]]:
    """Name and file of a phone's camera."""
    target = tmp_path_factory.mktemp("cameras") / "camera.y4m"
    write_camera(folder_of("rendered") / "videos" / "cam_0.mp4", target, 12, every=2)
    yield "<img src=x>", target
    target.unlink()


@pytest.fixture
def host(served: Served) -> Iterator[Page]:
    with opened(f"{served.client.base_url}#/record") as page:
        yield page


def files_of(served: Served, host: Page) -> list[dict[str, Any]]:
    """Parts of the clip of the only take and phone."""
    (take,) = recording_of(served, host)["takes"]
    (clip,) = take["clips"]
    return list(clip["files"])


def test_refused_phone_continues_and_says_why(
    host: Page, served: Served, camera: tuple[str, Path], tmp_path: Path
) -> None:
    link = open_recording(host, "Refused")
    lines: list[tuple[WebSocketRoute, WebSocketRoute]] = []
    is_away, num_refused = False, 0

    def forward(line: WebSocketRoute, server: WebSocketRoute, message: str | bytes) -> None:
        nonlocal num_refused
        if num_refused == 0 and isinstance(message, str) and json.loads(message)["type"] == "file":
            num_refused += 1
            line.send(json.dumps(OUTAGE | {"close_code": None}))
        else:
            server.send(message)

    def pass_on(line: WebSocketRoute) -> None:
        if is_away:
            line.send(json.dumps(OUTAGE))
            line.close()
        else:
            server = line.connect_to_server()
            line.on_message(partial(forward, line, server))
            lines.append((line, server))

    def refuse(route: Route) -> None:
        route.fulfill(status=413, content_type="application/problem+json", body=json.dumps({"detail": REASON}))

    with phones(host, link, [camera], tmp_path) as (phone,):
        phone.page.route_web_socket(re.compile("/connect$"), pass_on)
        phone.page.reload()
        phone.page.get_by_label("Name of this phone").fill(phone.name)
        join(host, [phone])
        start(host, "Refused", 2)
        phone.page.route("**/v1/uploads", refuse)
        is_away = True
        for end in lines[-1]:
            end.close()
        trouble = phone.page.get_by_role("alert")
        expect(trouble).to_contain_text("The database does not answer.")
        phone.expect_state("Recording")
        is_away = False
        expect(trouble).to_have_count(0)
        phone.expect_state("Recording")
        host.get_by_role("button", name="Stop").click()
        # The service's sentence is told on the phone and to the host.
        expect(phone.page.get_by_role("list", name="On this phone")).to_contain_text(f"waits: {REASON}")
        expect(phone_card(host, phone.name)).to_contain_text(REASON)
        phone.page.unroute("**/v1/uploads")
        expect(take_card(host, "Refused")).to_contain_text("1 of 1 clip here", timeout=PATIENT_MS)
        expect(phone_card(host, phone.name)).not_to_contain_text(REASON)
    assert num_refused == 1
    (file,) = files_of(served, host)
    assert (file["part"], file["facts"]["lost"]) == (1, [])


def test_turned_phone_begins_another_part(host: Page, served: Served, camera: tuple[str, Path], tmp_path: Path) -> None:
    link = open_recording(host, "Turned")
    with phones(host, link, [camera], tmp_path) as (phone,):
        join(host, [phone])
        start(host, "Turned", 3)
        phone.page.evaluate(
            """document.querySelector("video").srcObject.getVideoTracks()[0]
              .applyConstraints({ width: { exact: 360 }, height: { exact: 480 } })"""
        )
        expect(host.locator(".record-time")).to_have_text(re.compile("Turned · 0:(0[7-9]|[1-5].)"), timeout=60_000)
        host.get_by_role("button", name="Stop").click()
        wait_for(lambda: len(files_of(served, host)) == 2, timeout_s=60)
        expect(take_card(host, "Turned")).to_contain_text("1 of 1 clip here", timeout=PATIENT_MS)
    first, second = files_of(served, host)
    assert [(file["part"], file["facts"]["track"]["width"]) for file in (first, second)] == [(1, 640), (2, 360)]
    (lost,) = first["facts"]["lost"]
    assert second["first_frame_s"] == pytest.approx(lost["to_s"])
    assert lost["to_s"] - lost["from_s"] < 4.0
