"""Views without a connection: each says that it can't load, and loads when it can."""

import json
import re
from collections.abc import Iterator
from http import HTTPStatus
from pathlib import Path
from typing import Any

import httpx2
import pytest
from playwright.sync_api import Page, Request, expect

from tests.e2e.browsing import opened
from tests.e2e.captures import keypoint_capture
from tests.e2e.serving import Served
from tests.e2e.test_serve_keypoints import archives
from tests.waiting import wait_for

# Apart from the other tests of the page, which take long enough one after the other.
pytestmark = pytest.mark.xdist_group("waits")

# Messages of the browser itself about requests that can't be made.
ALLOWED = ("ERR_INTERNET_DISCONNECTED", "ERR_FAILED", "502 (Bad Gateway")
AWAY = "The service does not answer."


@pytest.fixture(scope="module")
def job(served: Served, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Finished job of keypoints, with a stored calibration of its cameras."""
    folder = tmp_path_factory.mktemp("offline")
    keypoint_capture(folder)
    content = (folder / "calibration.json").read_bytes()
    made = post_session(served, folder, "Offline")
    spec = ("spec", (None, json.dumps({"method": "file", "name": "Rig offline"}).encode(), "application/json"))
    served.client.post("/v1/calibrations", files=[spec, ("calibration", ("rig.json", content))]).raise_for_status()
    job = served.client.post(made["urls"]["jobs"], json={"frame_range": [0, 20]}).raise_for_status().json()
    return served.wait_for_end(job["id"]) | {"folder": folder, "jobs": made["urls"]["jobs"]}


def post_session(served: Served, folder: Path, name: str) -> dict[str, Any]:
    parts = [("keypoints", file) for _, file in archives(folder)]
    parts += [(part, (file, (folder / file).read_bytes())) for part, file in FILES.items()]
    manifest = ("manifest", (None, json.dumps({"name": name}).encode()))
    return dict(served.client.post("/v1/sessions", files=[*parts, manifest]).raise_for_status().json())


FILES = {"calibration": "calibration.json", "timestamps": "timestamps.csv"}


@pytest.fixture
def page(served: Served, job: dict[str, Any]) -> Iterator[Page]:
    assert job["state"] == "succeeded"
    with opened(f"{served.client.base_url}#/captures", allowed=ALLOWED) as page:
        expect(page.get_by_role("heading", name="Offline", exact=True, level=2).first).to_be_visible(timeout=180_000)
        yield page


def open_view(page: Page, view: str, job: dict[str, Any]) -> None:
    """Click what opens a view."""
    if view == "Job":
        page.get_by_role("link", name="Open Offline").first.click()
    else:
        page.get_by_role("navigation").get_by_role("link", name=view, exact=True).click()
    expect(page).to_have_url(re.compile(f"#/{ADDRESSES[view]}"))


ADDRESSES = {"New capture": "new", "Captures": "captures", "Calibrations": "calibrations", "Job": "jobs/"}
# Texts that a view shows once it has loaded.
LOADED = {
    "New capture": ("option", re.compile("Rig offline")),
    "Captures": ("button", re.compile("Run again: Offline|Reconstruct: Offline")),
    "Calibrations": ("button", "Download Rig offline"),
    "Job": ("link", re.compile(r"person-1\.bvh|\.bvh")),
}


@pytest.mark.parametrize(
    ("view", "is_known"),
    [("Captures", True), *((view, False) for view in LOADED)],
    ids=["loaded", *(f"{view}, new to the browser" for view in LOADED)],
)
def test_view_says_that_it_cannot_load_and_loads_when_it_can(
    served: Served, job: dict[str, Any], view: str, is_known: bool
) -> None:
    """With the code of the view in the browser, and without."""
    folder = {"New capture": "send", "Captures": "watch", "Calibrations": "calibrations", "Job": "look"}[view]
    start = "#/calibrations" if view == "Captures" else "#/captures"
    with opened("about:blank", allowed=ALLOWED) as page:
        if not is_known:
            page.route(f"**/portal/{folder}/view.js", lambda route: route.abort())
        page.goto(f"{served.client.base_url}{start}")
        first = "Calibrations" if view == "Captures" else "Captures"
        role, name = LOADED[first]
        expect(page.get_by_role(role, name=name).first).to_be_visible(timeout=180_000)  # type: ignore[arg-type]
        page.wait_for_load_state("networkidle")
        page.context.set_offline(True)
        open_view(page, view, job)
        alert = page.get_by_role("main").get_by_role("alert").filter(has_text=AWAY)
        expect(alert.first).to_be_visible()
        role, name = LOADED[view]
        expect(page.get_by_role(role, name=name)).to_have_count(0)  # type: ignore[arg-type]
        page.unroute_all()
        page.context.set_offline(False)
        expect(page.get_by_role(role, name=name).first).to_be_attached(timeout=180_000)  # type: ignore[arg-type]
        expect(alert).to_have_count(0)


def test_second_click_without_connection_opens_other_view(page: Page, job: dict[str, Any]) -> None:
    page.wait_for_load_state("networkidle")
    page.context.set_offline(True)
    open_view(page, "Calibrations", job)
    open_view(page, "New capture", job)
    open_view(page, "Calibrations", job)
    expect(page.get_by_role("heading", name="Calibrations", level=1)).to_be_visible()
    page.context.set_offline(False)
    expect(page.get_by_role("button", name="Download Rig offline").first).to_be_visible(timeout=180_000)


def test_job_is_followed_again(page: Page, served: Served, job: dict[str, Any]) -> None:
    """By its event stream, after the connection was lost, and after a server between refused the stream once."""
    streams: list[Request] = []
    page.on("request", lambda request: streams.append(request) if request.url.endswith("/events") else None)
    page.route("**/events", lambda route: route.fulfill(status=502, body=""), times=1)
    worker = served.part("worker")
    tree = [worker, *worker.children(recursive=True)]
    answers: list[httpx2.Response] = []

    def is_queued_for_nobody() -> bool:
        """Queue a job while the worker is suspended, unless that was in a transaction: the database is locked then."""
        for process in tree:
            process.suspend()
        answers.append(served.client.post(job["jobs"], json={"frame_range": [0, 15]}))
        if answers[-1].status_code == HTTPStatus.SERVICE_UNAVAILABLE:
            for process in tree:
                process.resume()
            return False
        return True

    try:
        wait_for(is_queued_for_nobody)
        waiting = answers[-1].raise_for_status().json()
        row = page.locator(f"#job-{waiting['id']}")
        expect(row.get_by_text("Waiting")).to_be_visible(timeout=180_000)
        for _ in range(1200):
            if len(streams) >= 2:
                break
            page.wait_for_timeout(50)
        assert len(streams) >= 2  # refused, then opened again
        page.context.set_offline(True)
        expect(page.get_by_role("banner").get_by_role("alert")).to_contain_text(AWAY, timeout=180_000)
        page.context.set_offline(False)
        expect(page.get_by_role("banner").get_by_role("alert")).to_have_count(0, timeout=180_000)
    finally:
        for process in tree:
            process.resume()
    expect(row.get_by_role("link", name="Open")).to_be_visible(timeout=240_000)
