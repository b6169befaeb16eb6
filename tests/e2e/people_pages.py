"""Pages with the people of a finished job, for tests in a real browser."""

import contextlib
import json
import re
import sqlite3
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import httpx2
import pytest
from playwright.sync_api import Locator, Page, ViewportSize, expect

from tests.e2e.browsing import opened
from tests.e2e.captures import keypoint_capture
from tests.e2e.serving import Served, serving
from tests.e2e.test_serve_keypoints import files
from tests.waiting import wait_for

MAKING_MS = 120_000
NARROW: ViewportSize = {"width": 390, "height": 844}


@dataclass
class ServedPeople:
    """Service with a key, and a finished job of three people of 100 frames."""

    served: Served
    key: str
    job_id: str

    @property
    def client(self) -> httpx2.Client:
        return self.served.client

    @property
    def url(self) -> str:
        return str(self.client.base_url)

    @property
    def job(self) -> dict[str, Any]:
        return dict(self.client.get(f"/v1/jobs/{self.job_id}").raise_for_status().json())

    @property
    def revision(self) -> int:
        """Revision of the job's files."""
        return int(self.job["revision"])

    def people(self) -> dict[str, Any]:
        """Edits with the numbers of people, and the people of the run."""
        answer = self.client.get(self.job["urls"]["edits"]).raise_for_status().json()
        edits = [
            {name: outcome.get(name, value) for name, value in edit.items()}
            for edit, outcome in zip(answer["edits"], answer["run"]["outcomes"], strict=True)
        ]
        return {**answer["run"], "edits": edits}

    def edit(self, *edits: dict[str, Any]) -> None:
        self.wait()
        path = f"{self.job['urls']['session']}/edits"
        self.client.put(path, json={"edits": edits, "job_id": self.job_id}).raise_for_status()
        self.wait()

    @contextlib.contextmanager
    def workers_stopped(self) -> Iterator[None]:
        """Let the processes that run chunks stand still during the block."""
        workers = self.served.part("worker").children(recursive=True)
        try:
            # A process that stands still within a transaction would hold up the whole service.
            for _ in range(100):
                for worker in workers:
                    worker.suspend()
                if self._can_be_written():
                    break
                for worker in workers:
                    worker.resume()
                time.sleep(0.05)
            yield
        finally:
            for worker in workers:
                worker.resume()

    def _can_be_written(self) -> bool:
        connection = sqlite3.connect(self.served.data_dir / "multicap.db", timeout=0.5, isolation_level=None)
        with contextlib.closing(connection):
            try:
                connection.execute("BEGIN IMMEDIATE")
            except sqlite3.OperationalError:
                return False
            connection.execute("ROLLBACK")
            return True

    def wait(self) -> None:
        wait_for(lambda: self.client.get(f"/v1/jobs/{self.job_id}").json()["files_state"] == "current", timeout_s=240)


@pytest.fixture(scope="module")
def portal(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServedPeople]:
    folder = tmp_path_factory.mktemp("people")
    keypoint_capture(folder, 4.0)
    data = folder / "data"
    make = [sys.executable, "-P", "-m", "api.cli.main", "keys", "create", "animator", "--json", "--data", str(data)]
    made = json.loads(subprocess.run(make, check=True, capture_output=True).stdout)
    with serving(data, 1) as served:
        served.client.headers["Authorization"] = f"Bearer {made['key']}"
        manifest = ("manifest", (None, json.dumps({"name": "Room, take 1"})))
        answer = served.client.post("/v1/jobs", files=[*files(folder), manifest])
        assert answer.status_code == 202, answer.text
        found = ServedPeople(served, made["key"], answer.json()["id"])
        found.wait()
        yield found


@pytest.fixture
def page(portal: ServedPeople) -> Iterator[Page]:
    if portal.people()["edits"]:
        portal.edit()
    allowed = ("401 (Unauthorized", "412 (Precondition", "422 (Unprocessable")
    with opened(portal.url, allowed=allowed) as page:
        sign_in(page, portal)
        yield page


def expect_in_one_screen(page: Page) -> None:
    """The buttons of the play head, both 3D views and all pictures of cameras are in sight together."""
    page.locator(".look-pair").evaluate("one => one.scrollIntoView()")
    parts = [page.get_by_role("button", name="Play (Space)"), *page.locator(".look-view").all()]
    assert len(parts) == 3
    for part in (*parts, *page.locator(".look-tile").all(), *page.locator(".look-range").all()):
        box = part.bounding_box()
        assert box is not None
        assert box["y"] >= 0, part
        assert box["y"] + box["height"] <= 800, part


def sign_in(page: Page, portal: ServedPeople) -> None:
    page.get_by_label("Key").fill(portal.key)
    page.get_by_role("button", name="Sign in").click()
    expect(page.get_by_role("heading", name="Captures", level=1)).to_be_visible(timeout=180_000)
    look_at(page, portal)


def look_at(page: Page, portal: ServedPeople) -> None:
    page.goto(f"/#/jobs/{portal.job_id}")
    expect(page.locator(".look-viewer[data-ready=true]")).to_be_visible(timeout=180_000)
    expect(panel(page)).to_be_visible()


def panel(page: Page) -> Locator:
    return page.get_by_role("region", name="Edit people")


def choose(page: Page, person: str, frame: int | None = None) -> None:
    # Not `check`, which looks at the element that was clicked: the list is drawn again meanwhile.
    radio = panel(page).get_by_role("radio", name=re.compile(f"^{person} "))
    radio.click()
    expect(radio).to_be_checked()
    if frame is not None:
        panel(page).get_by_label("Frame", exact=True).fill(str(frame))
        panel(page).get_by_label("Frame", exact=True).press("Enter")


def press(page: Page, name: str) -> None:
    panel(page).get_by_role("button", name=name, exact=True).click()


def rename(page: Page, person: str, name: str) -> None:
    choose(page, person)
    field = panel(page).get_by_label(f"New name of {person}")
    field.fill(name)
    field.press("Enter")


def made(page: Page, revision: int) -> None:
    """Wait until the files of a revision are there and the viewer shows them."""
    expect(panel(page).get_by_text(f"Revision {revision}", exact=True)).to_be_visible(timeout=MAKING_MS)
    expect(page.locator(".look-viewer[data-ready=true]")).to_be_visible(timeout=180_000)


def expect_in_view(page: Page, *names: str) -> None:
    """Wait until the viewer's table has these people."""
    rows = page.get_by_role("table", name="People").get_by_role("rowheader")
    expect(rows).to_have_text(names, timeout=180_000)


def frames_of_both(portal: ServedPeople, one: int, other: int) -> int:
    """Number of frames in which two people who were found are there."""
    spans = {person["id"]: person for person in portal.people()["found"]}
    frames = [
        set(range(spans[id_]["start_frame"], spans[id_]["start_frame"] + spans[id_]["num_frames"]))
        for id_ in (one, other)
    ]
    return len(frames[0] & frames[1])
