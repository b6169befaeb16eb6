"""View Look in a real browser: people are put right, edits undone, and a public link shows one job."""

import contextlib
import json
import re
import sqlite3
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Literal

import httpx2
import pytest
from playwright.sync_api import Error, Locator, Page, Route, ViewportSize, expect

from tests.e2e.browsing import axe_findings, opened, opened_by_a_stranger
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
    # Not `check`, which looks at the element that was clicked: the list is drawn anew meanwhile.
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


def test_people_are_merged_and_merge_is_undone(page: Page, portal: ServedPeople) -> None:
    revision = portal.revision
    frame = 40
    choose(page, "person-2", frame)
    page.get_by_role("button", name="Top").click()
    press(page, "Merge into person-1")
    question = page.get_by_role("dialog", name="Merge person-2 into person-1?")
    shared = frames_of_both(portal, 2, 1)
    expect(question).to_contain_text(f"Both exist in {shared} frames")
    expect(question).to_contain_text(f"{shared} of 100 frames of person-2 are lost")
    question.get_by_role("button", name="Keep both").click()
    expect(question).to_have_count(0)
    assert portal.people()["edits"] == []
    press(page, "Merge into person-1")
    question.get_by_role("button", name="Merge", exact=True).click()
    edits = panel(page).get_by_role("list", name="Edits").get_by_role("listitem")
    expect(edits).to_have_text([re.compile("Merge person-2 into person-1")])
    expect(panel(page).get_by_text(re.compile(f"Updating files to revision {revision + 1}"))).to_be_visible()
    # The focus stays on the button, which is for the next pair now.
    expect(panel(page).get_by_role("button", name="Merge into person-3")).to_be_focused()
    made(page, revision + 1)
    expect(page.locator("#announcer")).to_have_text(re.compile(f"The files of revision {revision + 1} are ready."))
    expect(panel(page).get_by_role("radio")).to_have_count(2)
    expect_in_view(page, "person-1", "person-3")
    expect(panel(page).get_by_label("Frame", exact=True)).to_have_value(str(frame))
    with page.expect_download() as download:
        page.get_by_role("region", name="Files").get_by_role("link", name="person-1.bvh").click()
    assert download.value.suggested_filename == f"room-take-1_revision-{revision + 1}_person-1.bvh"

    press(page, "Undo: Merge person-2 into person-1")
    made(page, revision + 2)
    # Its button is gone with the edit.
    expect(panel(page).get_by_role("heading", name="Edits")).to_be_focused()
    expect(panel(page).get_by_role("radio")).to_have_count(3)
    expect_in_view(page, "person-1", "person-2", "person-3")
    # Anywhere on the page, such as in the 3D view.
    page.locator(".look-canvas").focus()
    page.keyboard.press("Control+y")
    made(page, revision + 3)
    assert portal.people()["edits"] == [{"action": "merge", "person": 1, "other": 2}]
    page.keyboard.press("Control+z")
    made(page, revision + 4)
    assert portal.people()["edits"] == []


def test_split_exchange_rename_delete_and_cut(page: Page, portal: ServedPeople) -> None:
    before = portal.people()
    revision, num_frames = portal.revision, before["num_frames"]
    choose(page, "person-1", 30)
    press(page, "Split here")
    made(page, revision + 1)
    expect(panel(page).get_by_role("radio", name=f"person-4 frames 30 to {num_frames - 1}")).to_be_visible()
    choose(page, "person-2", 50)
    panel(page).get_by_label("Other person").select_option("person-3")
    press(page, "Exchange with person-3 from here on")
    made(page, revision + 2)
    choose(page, "person-3")
    panel(page).get_by_label("New name of person-3").fill("Zoë")
    panel(page).get_by_label("New name of person-3").press("Enter")
    made(page, revision + 3)
    expect_in_view(page, "person-1", "person-2", "Zoë", "person-4")
    choose(page, "person-4")
    press(page, "Delete person-4")
    made(page, revision + 4)
    choose(page, "person-1", 10)
    press(page, "Start the take here")
    made(page, revision + 5)
    expect(panel(page).get_by_text(f"{num_frames - 10} frames of {num_frames} kept")).to_be_visible()
    expect(page.get_by_role("slider", name="Play head")).to_have_attribute("max", str(num_frames - 11))
    # The viewer counts from the cut, the panel from the start of the whole take.
    expect(page.get_by_role("slider", name="Play head")).to_have_value("0")
    expect(panel(page).get_by_label("Frame", exact=True)).to_have_value("10")
    after = portal.people()
    assert [edit["action"] for edit in after["edits"]] == ["split", "exchange", "rename", "remove", "cut"]
    assert (after["start_frame"], after["stop_frame"]) == (10, num_frames)
    assert {one["name"]: [(p["person"], p["start_frame"]) for p in one["pieces"]] for one in after["people"]} == {
        "person-1": [(1, 0)],
        "person-2": [(2, 0), (3, 50)],
        "Zoë": [(3, 0), (2, 50)],
    }
    # Later edits name people by places, and stay.
    press(page, "Undo: Split person-1 at frame 30")
    made(page, revision + 6)
    assert [edit["action"] for edit in portal.people()["edits"]] == ["exchange", "rename", "remove", "cut"]
    press(page, "Redo")
    made(page, revision + 7)
    assert portal.people()["edits"] == after["edits"]


def test_range_of_timeline_trims_the_take(page: Page, portal: ServedPeople) -> None:
    revision, num_frames = portal.revision, portal.people()["num_frames"]
    page.locator(".look-canvas").focus()
    for key in ("Home", "Shift+ArrowRight", "i"):
        page.keyboard.press(key)
    page.get_by_role("button", name="Trim: keep this range of the take").click()
    made(page, revision + 1)
    assert portal.people()["edits"] == [{"action": "cut", "start_frame": 10, "stop_frame": num_frames}]
    expect(page.get_by_role("slider", name="Play head")).to_have_attribute("max", str(num_frames - 11))
    expect(page.locator(".look-span")).to_be_hidden()


def test_joint_is_keyed_and_its_files_have_it_there(page: Page, portal: ServedPeople) -> None:
    revision = portal.revision
    page.locator(".look-canvas").focus()
    page.keyboard.press("c")
    tool = page.get_by_role("region", name="Correct joints")
    choose(page, "person-1", 50)
    tool.get_by_label("Joint", exact=True).select_option("left wrist")
    field = tool.get_by_label("z", exact=True)
    keyed = round(float(field.input_value()) + 0.06, 3)
    field.fill(str(keyed))
    field.press("Enter")
    # The page shows it before a fit has run.
    expect(field).to_have_value(f"{keyed:.3f}")
    words = "Put left wrist of person-1 to its place at frame 50"
    expect(panel(page).get_by_role("list", name="Edits").get_by_role("listitem")).to_contain_text([words])
    made(page, revision + 1)
    (edit,) = portal.people()["edits"]
    assert (edit["action"], edit["joint"], edit["frame"]) == ("key", "left_wrist", 50)
    assert edit["place_m"][2] == pytest.approx(keyed, abs=1e-3)
    page.reload()
    look_at(page, portal)
    page.locator(".look-canvas").focus()
    page.keyboard.press("c")
    choose(page, "person-1", 50)
    tool.get_by_label("Joint", exact=True).select_option("left wrist")
    assert float(field.input_value()) == pytest.approx(keyed, abs=0.003)
    page.locator(".look-canvas").focus()
    page.keyboard.press("Control+z")
    made(page, revision + 2)
    assert portal.people()["edits"] == []


def test_people_who_never_meet_are_merged_at_once(page: Page, portal: ServedPeople) -> None:
    revision = portal.revision
    choose(page, "person-1", 50)
    press(page, "Split here")
    made(page, revision + 1)
    choose(page, "person-4")
    panel(page).get_by_label("Other person").select_option("person-1")
    press(page, "Merge into person-1")
    made(page, revision + 2)
    expect(page.get_by_role("dialog")).to_have_count(0)
    expect(panel(page).get_by_role("radio")).to_have_count(3)


def test_take_without_people_is_reported_empty(page: Page, portal: ServedPeople) -> None:
    portal.edit(*({"action": "remove", "person": person} for person in (1, 2, 3)))
    page.reload()
    look_at(page, portal)
    expect(page.get_by_text("Done: edits removed everyone")).to_be_visible()
    expect(panel(page).get_by_text("You deleted everyone.")).to_be_visible()
    expect(page.get_by_text("no person found")).to_have_count(0)
    press(page, "Undo, to restore the people")
    expect(panel(page).get_by_text("You deleted everyone.")).to_have_count(0)
    made(page, portal.revision)
    expect_in_view(page, "person-3")


def test_edits_are_stacked_and_shown_before_their_files(page: Page, portal: ServedPeople) -> None:
    """While no worker runs, edits show at once, and the files of the last revision stay listed."""
    revision = portal.revision
    files = page.get_by_role("region", name="Files")
    expect(files.get_by_role("link", name="person-1.bvh")).to_be_visible()
    video = page.locator(".look-canvas").element_handle()
    with portal.workers_stopped():
        choose(page, "person-1", 30)
        press(page, "Split here")
        rename(page, "person-2", "Anna")
        choose(page, "person-3")
        press(page, "Delete person-3")
        press(page, "Undo: Rename person-2 to Anna")
        rename(page, "person-2", "Eve")
        # The viewer and the lists show them.
        expect_in_view(page, "person-1", "Eve", "person-4")
        expect(page.locator(".look-label-person")).to_have_text(["person-1", "Eve", "person-4"])
        swatches = page.get_by_role("table", name="People").locator(".look-swatch")
        lanes = panel(page).locator(".lane .look-swatch")
        tint = "all => all.map((one) => getComputedStyle(one).getPropertyValue('--tint').trim())"
        assert swatches.evaluate_all(tint) == lanes.evaluate_all(tint)
        expect(panel(page).get_by_role("list", name="Edits").get_by_role("listitem")).to_have_count(3)
        wait_for(lambda: len(portal.people()["edits"]) == 3)
        assert [edit["action"] for edit in portal.people()["edits"]] == ["split", "remove", "rename"]
        expect(files).to_contain_text(f"The files of revision {revision + 5} are being made.")
        expect(files.get_by_role("link", name="person-3.bvh")).to_be_visible()
        with page.expect_download() as download:
            files.get_by_role("link", name="person-3.bvh").click()
        assert download.value.path().read_bytes().startswith(b"HIERARCHY")
    made(page, revision + 5)
    expect(files.get_by_role("heading", name="Eve", exact=True)).to_be_visible()
    expect(files.get_by_role("link", name=f"room-take-1_revision-{revision + 5}_person-2-eve.bvh")).to_be_visible()
    expect(files.get_by_text("are being made")).to_have_count(0)
    expect_in_view(page, "person-1", "Eve", "person-4")
    # The viewer stays open all the time.
    assert video.evaluate("one => one.isConnected")


def test_report_follows_edits_on_request(page: Page, portal: ServedPeople) -> None:
    session = portal.client.get(f"/v1/jobs/{portal.job_id}").json()["urls"]["session"]
    job = portal.client.post(f"{session}/jobs", json={"report": True}).raise_for_status().json()
    with_report = replace(portal, job_id=job["id"])
    with_report.wait()
    look_at(page, with_report)
    files = page.get_by_role("region", name="Files")
    expect(files.get_by_role("link", name="report.html")).to_be_visible()
    expect(files.get_by_role("button", name="Make them now")).to_have_count(0)
    rename(page, "person-2", "Anna")
    made(page, 1)
    expect(files).to_contain_text("The report shows the unedited take.")
    expect(files.get_by_role("link", name="room-take-1_report.html")).to_be_visible()
    files.get_by_role("button", name="Make them now").click()
    expect(files).to_contain_text("They are being made for revision 1.")
    expect(files.get_by_role("heading", name="Files")).to_be_focused()
    expect(files.get_by_role("link", name="room-take-1_revision-1_report.html")).to_be_visible(timeout=MAKING_MS)
    expect(files.get_by_text("the unedited take")).to_have_count(0)
    with page.expect_download() as download:
        files.get_by_role("link", name="room-take-1_revision-1_report.html").click()
    assert "Anna" in download.value.path().read_text()


def test_refused_edit_keeps_others(page: Page, portal: ServedPeople) -> None:
    revision = portal.revision
    held: list[Route] = []

    def hold_the_first(route: Route) -> None:
        if route.request.method == "PUT" and not held:
            held.append(route)
        else:
            route.continue_()

    page.route("**/edits", hold_the_first)
    choose(page, "person-1", 0)
    press(page, "Split here")  # in its first frame
    rename(page, "person-2", "Anna")
    edits = panel(page).get_by_role("list", name="Edits").get_by_role("listitem")
    expect(edits).to_have_count(2)
    held[0].continue_()
    expect(panel(page).get_by_role("alert")).to_contain_text("Person 1 can't be split at frame 0.")
    made(page, revision + 1)
    expect(edits).to_have_count(1)
    expect_in_view(page, "person-1", "Anna", "person-3")
    assert portal.people()["edits"] == [{"action": "rename", "person": 2, "name": "Anna"}]


def test_impossible_edits_say_what_to_do(page: Page, portal: ServedPeople) -> None:
    revision = portal.revision
    choose(page, "person-1", 0)
    press(page, "Split here")
    problem = panel(page).get_by_role("alert")
    expect(problem).to_contain_text(
        "Split person-1 at frame 0: Person 1 can't be split at frame 0. Choose a frame from 1 to"
    )
    assert portal.revision == revision


def test_two_people_who_edit_at_once(page: Page, portal: ServedPeople) -> None:
    theirs = {"action": "rename", "person": 3, "name": "Theirs"}
    choose(page, "person-1", 30)
    portal.edit(theirs)
    press(page, "Split here")
    problem = panel(page).get_by_role("alert")
    expect(problem).to_contain_text("Another user has changed the edits.")
    expect(problem).to_contain_text("Not done: Split person-1 at frame 30.")
    expect(panel(page).get_by_role("list", name="Edits")).to_contain_text("Rename person-3 to Theirs")
    assert portal.people()["edits"] == [theirs]
    revision = portal.revision
    press(page, "Apply to their edits")
    made(page, revision + 1)
    assert portal.people()["edits"] == [theirs, {"action": "split", "person": 1, "frame": 30}]
    # A change that nothing was done against shows as well.
    portal.edit()
    expect(panel(page).get_by_text("Another user has changed the edits. The list shows their version.")).to_be_visible(
        timeout=180_000
    )
    expect(panel(page).get_by_text("No edits yet.")).to_be_visible()


def test_later_run_keeps_edits_and_earlier_one_follows(page: Page, portal: ServedPeople) -> None:
    """A correction that was made on one run is in the next one, of another method and format."""
    portal.edit({"action": "rename", "person": 2, "name": "Anna"}, {"action": "remove", "person": 3})
    session = portal.job["urls"]["session"]
    spec = {"method": "clustering", "exports": ["glb"]}
    job = portal.client.post(f"{session}/jobs", json=spec).raise_for_status().json()
    later = replace(portal, job_id=job["id"])
    later.wait()
    assert {person["name"] for person in later.people()["people"]} >= {"Anna"}
    assert len(later.people()["people"]) == 2
    names = {file["person_name"] for file in portal.client.get(job["urls"]["results"]).json()["results"]}
    assert names >= {"Anna"}
    look_at(page, later)
    expect(panel(page).get_by_role("list", name="Edits").get_by_role("listitem")).to_have_count(2)
    rename(page, "Anna", "Eve")
    made(page, 1)
    # The earlier run follows when it is told to.
    look_at(page, portal)
    expect(panel(page)).to_contain_text("The files show earlier edits of the capture.")
    press(page, "Apply the edits")
    made(page, portal.revision)
    expect_in_view(page, "person-1", "Eve")
    expect(panel(page).get_by_text("earlier edits")).to_have_count(0)


def test_files_are_added_to_finished_job(page: Page, portal: ServedPeople) -> None:
    revision = portal.revision
    files = page.get_by_role("region", name="Files")
    files.get_by_text("Add files").click()
    files.get_by_role("checkbox", name=re.compile("^GLB")).check()
    files.get_by_role("checkbox", name="Report").check()
    files.get_by_label("Target application").select_option("blender")
    assert axe_findings(page) == []
    files.get_by_role("button", name="Add the files").click()
    made(page, revision + 1)
    expect(files.get_by_role("link", name="person-1.glb")).to_be_visible()
    expect(files.get_by_role("link", name="BVH, animation for Blender").first).to_be_visible()
    # The report follows by itself, or at once.
    with contextlib.suppress(Error):
        files.get_by_role("button", name="Make them now").click(timeout=3_000)
    expect(files.get_by_role("link", name="report.html")).to_be_visible(timeout=MAKING_MS)


def test_another_job_is_compared_on_same_clock(page: Page, portal: ServedPeople) -> None:
    shown = portal.client.get(f"/v1/jobs/{portal.job_id}").json()
    for job in portal.client.get("/v1/jobs").raise_for_status().json()["jobs"]:
        if job["id"] != portal.job_id:
            portal.client.delete(f"/v1/jobs/{job['id']}").raise_for_status()
    # Earlier tests may have added files to the job, which are choices too.
    spec = shown["spec"] | {"smoothing": "none"}
    answer = portal.client.post(f"{shown['urls']['session']}/jobs", json=spec).raise_for_status().json()
    wait_for(lambda: portal.client.get(f"/v1/jobs/{answer['id']}").json()["state"] == "succeeded", timeout_s=240)
    page.reload()
    look_at(page, portal)
    # The jobs differ in one choice alone.
    expect(page.get_by_label("Compare with").locator("option")).to_have_text(["no other job", "Smoothing: None"])
    page.get_by_label("Compare with").select_option(answer["id"])
    expect(page.locator(".look-viewer[data-ready=true]")).to_have_count(2, timeout=180_000)
    expect(page.get_by_role("region", name="Smoothing: None")).to_be_visible()
    expect_in_one_screen(page)
    choose(page, "person-1", 60)
    for slider in page.get_by_label("Play head").all():
        expect(slider).to_have_value("60")
    assert axe_findings(page) == []


def test_public_link_shows_one_job_until_revoked(page: Page, portal: ServedPeople) -> None:
    sharing = page.get_by_role("region", name="Public link")
    sharing.get_by_label("Ends after").select_option("1 day")
    sharing.get_by_role("button", name="Make a link").click()
    field = sharing.get_by_label("New link, shown only now")
    expect(field).to_be_focused()
    address = field.input_value()
    assert address.startswith(f"{portal.url.rstrip('/')}/#/jobs/{portal.job_id}?link=mcl_")
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    sharing.get_by_role("button", name="Copy the link").click()
    expect(page.locator("#announcer")).to_have_text(re.compile("The link is copied."))
    assert page.evaluate("navigator.clipboard.readText()") == address

    with opened_by_a_stranger(page, address, allowed=("401 (Unauthorized",)) as guest:
        expect(guest.locator(".look-viewer[data-ready=true]")).to_be_visible(timeout=180_000)
        expect(guest.get_by_role("heading", name="Room, take 1", level=1)).to_be_visible()
        expect(guest.get_by_role("region", name="Edit people")).to_have_count(0)
        expect(guest.get_by_role("region", name="Public link")).to_have_count(0)
        expect(guest.get_by_role("navigation")).to_have_count(0)
        with guest.expect_download() as download:
            guest.get_by_role("link", name="person-1.bvh").click()
        assert download.value.path().read_bytes().startswith(b"HIERARCHY")
        assert axe_findings(guest) == []
        # The link opens nothing else.
        secret = address.partition("link=")[2]
        for path in ("/v1/jobs", f"{portal.job['urls']['session']}/edits", f"/v1/jobs/{portal.job_id}/links"):
            assert guest.request.get(f"{portal.url.rstrip('/')}{path}?link={secret}").status == 401

        sharing.get_by_role("button", name="Revoke").click()
        page.get_by_role("dialog").get_by_role("button", name="Revoke", exact=True).click()
        expect(sharing.get_by_role("list", name="Links")).to_have_count(0)
        expect(sharing.get_by_role("heading", name="Public link")).to_be_focused()
        guest.reload()
        expect(guest.get_by_role("heading", name="This link has ended or was revoked")).to_be_visible(timeout=180_000)
        expect(guest.get_by_text("Ask the person who sent it")).to_be_visible()


@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (390, "dark")])
def test_panel_is_accessible_and_fits(
    page: Page, portal: ServedPeople, width: int, scheme: Literal["light", "dark"]
) -> None:
    portal.edit({"action": "split", "person": 1, "frame": 30}, {"action": "cut", "start_frame": 10, "stop_frame": 90})
    page.set_viewport_size({"width": width, "height": 844})
    page.emulate_media(color_scheme=scheme, reduced_motion="reduce")
    page.reload()
    look_at(page, portal)
    page.get_by_role("button", name="Make a link").click()
    expect(page.get_by_label("New link, shown only now")).to_be_visible()
    choose(page, "person-2", 40)
    assert axe_findings(page) == []
    assert page.evaluate("document.scrollingElement.scrollWidth") <= width
    names = page.get_by_role("button").evaluate_all("all => all.map((one) => one.ariaLabel ?? one.textContent.trim())")
    assert len(names) == len(set(names))
