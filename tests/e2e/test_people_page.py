"""View Look in a real browser: people are put right, and edits undone."""

import re

import pytest
from playwright.sync_api import Page, Route, expect

from tests.e2e.people_pages import (
    ServedPeople,
    choose,
    expect_in_view,
    frames_of_both,
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


def test_sex_and_mass_stay_with_their_person_until_set(page: Page, portal: ServedPeople) -> None:
    revision = portal.revision
    sex, mass = panel(page).get_by_role("combobox", name="Sex"), panel(page).get_by_role("spinbutton", name="Mass, kg")
    choose(page, "person-1")
    sex.select_option("female")
    mass.fill("61")
    choose(page, "person-2")
    expect(sex).to_have_value("")
    expect(mass).to_have_value("")
    mass.fill("80")
    # The panel is drawn again before the values are set.
    panel(page).get_by_label("Other person").select_option("person-3")
    press(page, "Set sex and mass of person-2")
    made(page, revision + 1)
    (edit,) = portal.people()["edits"]
    assert (edit["action"], edit["person"], edit.get("sex"), edit["mass_kg"]) == ("describe", 2, None, 80.0)
    expect(mass).to_have_value("80")


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
