"""Page at ``/`` in a real browser: the sample capture from the form to the downloaded files."""

import contextlib
import hashlib
import json
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
from playwright.sync_api import Page, expect, sync_playwright

from pipeline.calibration.registry import read_calibration
from pipeline.calibration.write import encode
from pipeline.runtime.packages.samples import Sample
from tests.e2e.serving import Served, digests, serving

pytestmark = pytest.mark.xdist_group("sample")

# The browser makes no requests of its own, and root may start it.
FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-component-update"]


@contextlib.contextmanager
def opened(url: str) -> Iterator[Page]:
    """Open the page in a new browser; at the end of the block check that no script has failed."""
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("there is no chromium (`make browser` installs it on Debian)")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=FLAGS)
        page = browser.new_page(base_url=url)
        complaints: list[str] = []
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.goto("/")
        yield page
        browser.close()
    assert complaints == []


@pytest.fixture
def page(served: Served) -> Iterator[Page]:
    with opened(str(served.client.base_url)) as page:
        yield page


def test_a_capture_from_the_form_to_its_files(page: Page, sample: Sample, results: Path) -> None:
    page.get_by_label("Name").fill("<b>Take</b> 1")
    page.get_by_label("Videos").set_input_files(list(sample.videos.values()))
    page.get_by_label("Calibration of all cameras").set_input_files(sample.calibration)
    page.get_by_role("button", name="Send and reconstruct").click()
    job = page.get_by_role("listitem").filter(has=page.get_by_role("heading", name="<b>Take</b> 1")).first
    expect(job.get_by_text("Running")).to_be_visible(timeout=60_000)
    expect(job.get_by_text("Done, with warnings", exact=True)).to_be_visible(timeout=240_000)
    # The page requests the files of a finished job then, and shows them after the response.
    expect(job.get_by_role("link", name="All as ZIP")).to_be_visible()
    found, packed = {}, {}
    for link in job.get_by_role("link").all():
        with page.expect_download() as download:
            link.click()
        path, name = download.value.path(), download.value.suggested_filename
        if name.endswith(".zip"):
            with zipfile.ZipFile(path) as archive:
                packed = {one: hashlib.sha256(archive.read(one)).hexdigest() for one in archive.namelist()}
        else:
            found[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    assert found == packed == digests(results)


def test_a_stored_calibration_is_added_chosen_and_deleted(page: Page, served: Served, sample: Sample) -> None:
    page.get_by_text("Calibrations", exact=True).click()
    page.get_by_label("Title").fill("<i>Studio</i> B")
    page.get_by_label("File", exact=True).set_input_files(sample.calibration)
    page.get_by_role("button", name="Add").click()
    stored = page.get_by_role("listitem").filter(has=page.get_by_role("heading", name="<i>Studio</i> B"))
    expect(stored.get_by_text("ready")).to_be_visible(timeout=30_000)
    stored.get_by_text("Cameras", exact=True).click()
    expect(stored.get_by_role("row")).to_have_count(1 + len(sample.videos))
    with page.expect_download() as download:
        stored.get_by_role("link", name="as Caliscope TOML").click()
    assert len(read_calibration(download.value.path().rename(download.value.path().with_suffix(".toml")))) == 4
    page.get_by_label("Stored calibration").select_option("<i>Studio</i> B")
    expect(page.get_by_label("Calibration of all cameras")).to_be_hidden()
    page.get_by_label("Videos, one a camera").set_input_files(list(sample.videos.values()))
    with page.expect_request("**/v1/jobs") as sent:
        page.get_by_role("button", name="Send and reconstruct").click()
    job_id = sent.value.response().json()["id"]  # type: ignore[union-attr]
    files = served.client.get(served.job(job_id)["links"]["session"]).json()["files"]
    assert [one["name"][:12] for one in files if one["kind"] == "calibration"] == ["calibration-"]
    served.client.post(f"/v1/jobs/{job_id}/cancel")
    page.once("dialog", lambda dialog: dialog.accept())
    stored.get_by_role("button", name="Delete").click()
    expect(stored).to_have_count(0, timeout=30_000)


def test_the_choices_of_the_form_are_those_of_the_api(page: Page, served: Served) -> None:
    properties = served.client.get("/openapi.json").json()["components"]["schemas"]["JobSpec"]["properties"]
    page.get_by_text("Options", exact=True).click()
    for name, label in (
        ("method", "Method"),
        ("profile", "Profile"),
        ("joints", "Joints"),
        ("detector", "Detector"),
        ("smoothing", "Smoothing"),
        ("feet", "Feet on the floor"),
        ("appearance", "Colours of clothes"),
        ("joint_centers", "Joint centres"),
        ("refine_calibration", "Refinement of the calibration"),
        ("bvh", "Application for BVH files"),
    ):
        field = page.locator(f"select[name={name}]")
        assert field.evaluate("one => one.labels[0].textContent").startswith(label)
        options = field.get_by_role("option").evaluate_all("all => all.map(one => one.value)")
        # The networks of users are texts of a pattern beside the names.
        (names,) = [one["enum"] for one in properties[name].get("anyOf", [properties[name]]) if "enum" in one]
        assert sorted(options) == sorted(names)
        assert field.input_value() == properties[name]["default"]
    boxes = page.get_by_role("group", name="Files of each person").get_by_role("checkbox")
    chosen = boxes.evaluate_all("all => all.filter(one => one.checked).map(one => one.value)")
    assert chosen == properties["exports"]["default"]
    assert boxes.evaluate_all("all => all.map(one => one.value)") == properties["exports"]["items"]["enum"]


def test_all_problems_of_a_capture_are_shown(page: Page, sample: Sample, tmp_path: Path) -> None:
    broken = tmp_path / "broken.mp4"
    broken.write_bytes(b"no video")
    calibration = tmp_path / "calibration.toml"
    calibration.write_text("no calibration")
    page.get_by_label("Videos").set_input_files([broken, sample.videos[min(sample.videos)]])
    page.get_by_label("Calibration of all cameras").set_input_files(calibration)
    page.get_by_role("button", name="Send and reconstruct").click()
    problems = page.locator("form").get_by_role("alert")
    expect(problems).to_contain_text("broken.mp4", timeout=60_000)
    expect(problems).to_contain_text("calibration.toml")
    expect(page.get_by_role("button", name="Send and reconstruct")).to_be_enabled()


def post(served: Served, jobs: str, frames: list[int]) -> dict[str, Any]:
    answer = served.client.post(jobs, json={"frame_range": frames}).raise_for_status()
    return served.wait_for_end(answer.json()["id"])


def test_warnings_of_a_result_are_shown_and_no_retry_that_would_fail_the_same_way(
    page: Page, served: Served, sample: Sample
) -> None:
    cameras = read_calibration(sample.calibration)[:2]
    videos = [sample.videos[camera.name] for camera in cameras]
    files = [("videos", (path.name, path.read_bytes())) for path in videos]
    files += [("calibration", ("calibration.json", encode(cameras)))]
    manifest = ("manifest", (None, json.dumps({"name": "Two cameras"}).encode()))
    session = served.client.post("/v1/sessions", files=[*files, manifest]).raise_for_status().json()

    done = post(served, session["links"]["jobs"], [0, 10])
    assert done["result_warnings"][0]["code"] == "too_few_cameras"
    assert done["result_warnings"][0]["message"] in done["warnings"]
    inputs = served.data_dir / "artifacts" / "sessions" / session["id"] / "inputs"
    for path in inputs.glob("*.mp4"):
        path.write_bytes(b"what a broken disk gives back")
    failed = post(served, session["links"]["jobs"], [20, 30])
    assert (failed["state"], failed["error"]["retryable"], failed["links"]["retry"]) == ("failed", False, None)

    page.reload()
    cards = page.get_by_role("listitem").filter(has=page.get_by_role("heading", name="Two cameras"))
    warned = cards.filter(has_text="Done")
    expect(warned.get_by_text("Done, with warnings", exact=True)).to_be_visible()
    expect(warned.get_by_role("list", name="Warnings")).to_contain_text("The session has 2 cameras")
    refused = cards.filter(has_text="Failed")
    expect(refused.locator(".problems")).to_contain_text(failed["error"]["detail"])
    expect(refused.get_by_role("button", name="Delete")).to_be_visible()
    for card in (warned, refused):
        expect(card.get_by_role("button", name="Retry")).to_be_hidden()
        expect(card.get_by_role("button", name="Cancel")).to_be_hidden()


def test_detectors_that_are_not_installed_cannot_be_chosen(page: Page, served: Served) -> None:
    known = served.client.get("/v1/options").raise_for_status().json()["detectors"]
    assert known[0]["installed"] is True
    page.get_by_text("Options", exact=True).click()
    options = page.get_by_label("Detector").get_by_role("option")
    for detector in known:
        option = options.and_(page.locator(f"[value={detector['name']}]"))
        if detector["installed"]:
            expect(option).to_be_enabled()
        else:
            expect(option).to_be_disabled()
            expect(option).to_contain_text("(not installed)")


def make_key(data_dir: Path, *options: str) -> str:
    command = [sys.executable, "-m", "api.cli.main", "keys", "create", "portal", "--tenant", "studio", "--json"]
    made = subprocess.run([*command, "--data", str(data_dir), *options], capture_output=True, text=True, check=True)
    return str(json.loads(made.stdout)["key"])


def test_with_keys_a_browser_has_to_show_one(tmp_path: Path) -> None:
    secret, reading = make_key(tmp_path), make_key(tmp_path, "--scope", "read")
    with serving(tmp_path) as served, opened(str(served.client.base_url)) as page:
        sending = page.get_by_role("heading", name="New capture")
        expect(page.get_by_role("heading", name="Sign in")).to_be_visible()
        expect(sending).to_be_hidden()
        page.get_by_label("Key").fill("mc_wrong")
        page.get_by_role("button", name="Sign in").click()
        expect(page.get_by_role("alert")).to_contain_text("not known")
        page.get_by_label("Key").fill(secret)
        page.get_by_role("button", name="Sign in").click()
        expect(sending).to_be_visible()
        expect(page.get_by_text("portal, studio")).to_be_visible()
        expect(page.get_by_text("No jobs yet")).to_be_visible()
        page.reload()
        expect(sending).to_be_visible()
        assert page.evaluate("document.cookie") == ""
        page.get_by_role("button", name="Sign out").click()
        expect(page.get_by_role("heading", name="Sign in")).to_be_visible()
        page.reload()
        expect(sending).to_be_hidden()
        page.get_by_label("Key").fill(reading)
        page.get_by_role("button", name="Sign in").click()
        expect(page.get_by_text("No jobs yet")).to_be_visible()
        expect(sending).to_be_hidden()


def test_the_contract_is_shown_without_anybody_else(served: Served) -> None:
    asked, refused = set(), []
    with opened(str(served.client.base_url)) as page:
        page.on("request", lambda request: asked.add(urlsplit(request.url).netloc))
        page.on("console", lambda message: refused.append(message.text) if message.type == "error" else None)
        page.get_by_role("link", name="The web API").click()
        expect(page.get_by_text("Reconstruct a session", exact=True)).to_be_visible(timeout=30_000)
        page.get_by_role("button", name="GET /healthz Check that").click()
        page.get_by_role("button", name="Try it out").click()
        page.get_by_role("button", name="Execute").click()
        expect(page.locator(".live-responses-table .response-col_status").last).to_contain_text("200")
    assert asked == {served.client.base_url.netloc.decode()}
    assert refused == []  # requests refused by the Content-Security-Policy
