"""View Look in a real browser: files and later runs follow edits, and a public link shows one job."""

import contextlib
import re
from dataclasses import replace
from typing import Literal

import pytest
from playwright.sync_api import Error, Page, expect

from tests.e2e.browsing import axe_findings, opened_by_a_stranger
from tests.e2e.people_pages import (
    MAKING_MS,
    ServedPeople,
    choose,
    expect_in_one_screen,
    expect_in_view,
    look_at,
    made,
    page,
    panel,
    portal,
    press,
    rename,
)
from tests.waiting import wait_for

__all__ = ["page", "portal"]


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
