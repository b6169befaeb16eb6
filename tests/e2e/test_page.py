"""Page at ``/`` in a real browser: captures from the form to the downloaded files."""

import hashlib
import json
import re
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest
from playwright.sync_api import Locator, Page, expect

from pipeline.calibration.contents import scaled
from pipeline.calibration.registry import read_calibration
from pipeline.calibration.write import encode, encode_toml
from pipeline.core.runtime.packages.samples import Sample
from pipeline.validation.simulation.scenes import find_scene, record
from tests.e2e.browsing import choose_option, opened
from tests.e2e.captures import cameras_of_two_videos, two_videos
from tests.e2e.conftest import NUM_FIRST
from tests.e2e.serving import Served, digests, serving
from tests.pipeline.keypoint_programs import freemocap_array

pytestmark = pytest.mark.xdist_group("page")


@pytest.fixture
def page(served: Served) -> Iterator[Page]:
    with opened(f"{served.client.base_url}#/new") as page:
        yield page


def choose(page: Page, *paths: Path) -> None:
    """Choose the files of a capture."""
    page.get_by_label("Choose files").set_input_files(paths)


def capture(page: Page, name: str) -> Locator:
    """Card of a capture in the view of captures."""
    return page.get_by_role("listitem").filter(has=page.get_by_role("heading", name=name, exact=True, level=2))


def test_capture_goes_from_form_to_files(page: Page, sample: Sample, first_results: Path) -> None:
    page.get_by_label("Name of the capture").fill("<b>Take</b> 1")
    choose(page, *sample.videos.values(), sample.calibration)
    expect(page.get_by_label("Camera of cam02.mp4")).to_have_value("cam02", timeout=180_000)
    page.get_by_text("Customise", exact=True).click()
    page.get_by_label("after the last").fill(str(NUM_FIRST))
    page.get_by_role("button", name="Send and reconstruct").click()
    expect(page.get_by_role("heading", name="<b>Take</b> 1", level=1)).to_be_visible(timeout=180_000)
    expect(page.get_by_text("Running").first).to_be_visible(timeout=180_000)
    expect(page.get_by_text("Done, with warnings", exact=True)).to_be_visible(timeout=240_000)
    files = page.get_by_role("region", name="Files")
    found, packed = {}, {}
    expect(files.get_by_role("link", name="All as ZIP")).to_be_visible()
    for link in files.get_by_role("link").all():
        with page.expect_download() as download:
            link.click()
        path, name = download.value.path(), download.value.suggested_filename
        if name.endswith(".zip"):
            with zipfile.ZipFile(path) as archive:
                packed = {Path(one).name: hashlib.sha256(archive.read(one)).hexdigest() for one in archive.namelist()}
        else:
            found[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    assert found == packed == {f"b-take-b-1_{name}": sha256 for name, sha256 in digests(first_results).items()}


@pytest.mark.slow
def test_calibration_is_added_chosen_and_deleted(page: Page, served: Served, tmp_path: Path) -> None:
    paths = two_videos(tmp_path)
    page.get_by_role("link", name="Calibrations", exact=True).click()
    page.get_by_label("Name", exact=True).fill("<i>Studio</i> B")
    page.get_by_label("File", exact=True).set_input_files(paths["calibration.json"])
    page.get_by_role("button", name="Add").click()
    stored = capture(page, "<i>Studio</i> B")
    expect(stored.get_by_text("ready")).to_be_visible(timeout=180_000)
    stored.get_by_text("Cameras", exact=True).click()
    expect(stored.get_by_role("row")).to_have_count(1 + 2)
    with page.expect_download() as download:
        stored.get_by_label("Format of <i>Studio</i> B").select_option("Caliscope TOML")
        stored.get_by_role("button", name="Download").click()
    assert len(read_calibration(download.value.path().rename(download.value.path().with_suffix(".toml")))) == 2
    page.get_by_role("link", name="New capture").click()
    choose_option(page.get_by_label("Stored calibration"), "<i>Studio</i> B")
    choose(page, paths["left.mp4"], paths["right.mp4"])
    with page.expect_response("**/v1/sessions/*/jobs", timeout=120_000) as answer:
        page.get_by_role("button", name="Send and reconstruct").click()
    files = served.client.get(answer.value.json()["urls"]["session"]).json()["files"]
    assert [one["name"][:12] for one in files if one["kind"] == "calibration"] == ["calibration-"]
    served.client.post(f"/v1/jobs/{answer.value.json()['id']}/cancel")
    page.get_by_role("link", name="Calibrations", exact=True).click()
    stored.get_by_role("button", name="Delete").click()
    page.get_by_role("dialog").get_by_role("button", name="Delete the calibration").click()
    expect(stored).to_have_count(0, timeout=180_000)


def test_capture_shows_all_its_problems(served: Served, sample: Sample, tmp_path: Path) -> None:
    broken, other = tmp_path / "cam01.mp4", tmp_path / "cam02.mp4"
    broken.write_bytes(b"no video")
    other.write_bytes(b"no video either")
    with opened(f"{served.client.base_url}#/new", allowed=("422 (Unprocessable",)) as page:
        calibration = tmp_path / "calibration.toml"
        calibration.write_text("no calibration")
        choose(page, calibration)
        problems = page.get_by_role("region", name="Send").get_by_role("alert")
        expect(problems).to_contain_text("calibration.toml", timeout=180_000)
        choose(page, broken, other, sample.calibration)
        expect(page.get_by_label("Camera of cam02.mp4")).to_have_value("cam02", timeout=180_000)
        page.get_by_role("button", name="Send and reconstruct").click()
        expect(problems).to_contain_text("cam01.mp4", timeout=180_000)
        expect(problems).to_contain_text("cam02.mp4")
        expect(page.get_by_role("button", name="Send and reconstruct")).to_be_enabled()


@pytest.mark.slow
def test_unknown_unit_is_asked_for(served: Served, tmp_path: Path) -> None:
    paths = two_videos(tmp_path)
    in_mm = tmp_path / "rig.toml"
    in_mm.write_bytes(encode_toml([scaled(camera, 1000.0) for camera in cameras_of_two_videos()]))
    with opened(f"{served.client.base_url}#/new", allowed=("422 (Unprocessable",)) as page:
        choose(page, in_mm, paths["left.mp4"], paths["right.mp4"])
        send = page.get_by_role("region", name="Send")
        expect(send.get_by_role("alert")).to_contain_text("m if they are millimetres", timeout=180_000)
        page.get_by_label("Unit of length").select_option("mm")
        expect(page.get_by_text("in mm")).to_be_visible(timeout=180_000)
        page.get_by_label("Up axis").select_option("-z")
        expect(page.get_by_text("The cameras are upside down")).to_be_visible(timeout=180_000)
        page.get_by_label("Up axis").select_option("")
        expect(page.get_by_text("The cameras are upside down")).to_have_count(0, timeout=180_000)
        expect(send.get_by_role("alert")).to_have_count(0)
        expect(page.get_by_role("button", name="Send and reconstruct")).to_be_enabled()


@pytest.mark.slow
def test_array_has_points_of_all_cameras(page: Page, served: Served, tmp_path: Path) -> None:
    simulation = record(replace(find_scene("room"), duration_s=1.0), seed=4, num_views=2)
    rig, array, other = (tmp_path / name for name in ("rig.json", "mediapipe_2dData_numCams.npy", "cam_00.mp4"))
    rig.write_bytes(encode(simulation.cameras))
    np.save(array, freemocap_array(simulation))
    other.write_bytes(bytes(100))
    page.get_by_label("Name of the capture").fill("Array")
    choose(page, rig, array, other)
    expect(page.get_by_text("all cameras, by order of names")).to_be_visible(timeout=180_000)
    page.get_by_label("Frame rate of keypoints").fill("25")
    page.get_by_role("button", name="Send and reconstruct").click()
    problems = page.get_by_role("region", name="Send").get_by_role("alert")
    expect(problems).to_contain_text("has the keypoints of all cameras", timeout=180_000)
    page.get_by_role("button", name="Remove cam_00.mp4").click()
    page.get_by_role("button", name="Send and reconstruct").click()
    expect(page.get_by_role("heading", name="Array", level=1)).to_be_visible(timeout=180_000)
    session = next(
        stored for stored in served.client.get("/v1/sessions").json()["sessions"] if stored["name"] == "Array"
    )
    cameras = served.client.get(f"/v1/sessions/{session['id']}").json()["preflight"]["cameras"]
    assert [(seen["name"], seen["file"]) for seen in cameras] == [
        (camera.name, array.name) for camera in simulation.cameras
    ]


def throttle(page: Page, bytes_per_s: int) -> None:
    """Limit what the browser sends; -1: no limit."""
    session = page.context.new_cdp_session(page)
    session.send("Network.enable")
    speed = {"offline": False, "latency": 0, "downloadThroughput": -1, "uploadThroughput": bytes_per_s}
    session.send("Network.emulateNetworkConditions", speed)


@pytest.mark.slow
def test_upload_continues_after_reload(page: Page, served: Served, sample: Sample) -> None:
    offsets: list[int] = []
    page.on("request", lambda one: offsets.append(int(one.headers["upload-offset"])) if one.method == "PATCH" else None)
    choose(page, *sample.videos.values(), sample.calibration)
    expect(page.get_by_label("Camera of cam04.mp4")).to_have_value("cam04", timeout=180_000)
    page.get_by_label("Offset in seconds of cam03.mp4").fill("0.25")
    throttle(page, 150_000)
    page.get_by_role("button", name="Send and reconstruct").click()
    expect(page.get_by_role("link", name=re.compile(r"Sending, [1-9]\d %"))).to_be_visible(timeout=180_000)
    assert set(offsets) <= {0}
    page.get_by_label("Name of the capture").fill("Cut and gone on")  # typed while files are sent
    page.get_by_role("radio", name="Blender").check()
    page.get_by_role("button", name="Pause").click()
    expect(page.get_by_role("button", name="Continue")).to_be_visible()
    page.get_by_role("button", name="Continue").click()
    expect(page.get_by_role("button", name="Pause")).to_be_visible()
    page.wait_for_timeout(1000)  # the draft is stored
    page.reload()
    expect(page.get_by_text("The upload stopped at")).to_be_visible()
    offsets.clear()
    throttle(page, -1)
    with page.expect_response("**/v1/sessions/*/jobs", timeout=120_000) as answer:
        choose(page, *sample.videos.values())
    job = answer.value.json()
    served.client.post(f"/v1/jobs/{job['id']}/cancel")
    assert max(offsets) > 0, "every file was sent from its start"
    assert sum(offsets) < sum(path.stat().st_size for path in sample.videos.values())
    assert (job["session_name"], job["spec"]["preset"]) == ("Cut and gone on", "blender")
    session = served.client.get(job["urls"]["session"]).json()
    starts = {one["name"]: one["start_time_s"] for one in session["preflight"]["cameras"]}
    assert starts["cam03"] - starts["cam01"] == pytest.approx(0.25, abs=1e-3)
    sizes = {one["name"]: one["num_bytes"] for one in session["files"] if one["kind"] == "video"}
    assert sizes == {path.name: path.stat().st_size for path in sample.videos.values()}


def post(served: Served, jobs: str, frames: list[int]) -> dict[str, Any]:
    answer = served.client.post(jobs, json={"frame_range": frames}).raise_for_status()
    return served.wait_for_end(answer.json()["id"])


@pytest.mark.slow
def test_warnings_are_shown_without_useless_retry(page: Page, served: Served, sample: Sample) -> None:
    cameras = read_calibration(sample.calibration)[:2]
    videos = [sample.videos[camera.name] for camera in cameras]
    files = [("videos", (path.name, path.read_bytes())) for path in videos]
    files += [("calibration", ("calibration.json", encode(cameras)))]
    manifest = ("manifest", (None, json.dumps({"name": "Two cameras"}).encode()))
    session = served.client.post("/v1/sessions", files=[*files, manifest]).raise_for_status().json()

    done = post(served, session["urls"]["jobs"], [0, 4])
    assert "too_few_cameras" in [warning["code"] for warning in done["warnings"]]
    inputs = served.data_dir / "artifacts" / "sessions" / session["id"] / "inputs"
    for path in inputs.glob("*.mp4"):
        path.write_bytes(b"what a broken disk gives back")
    failed = post(served, session["urls"]["jobs"], [20, 24])
    assert (failed["state"], failed["error"]["retryable"], failed["urls"]["retry"]) == ("failed", False, None)

    page.get_by_role("link", name="Captures", exact=True).click()
    card = capture(page, "Two cameras")
    warned = card.get_by_role("listitem").filter(has_text="Done").first
    expect(warned.get_by_text("Done, with warnings", exact=True)).to_be_visible()
    expect(warned.get_by_role("list", name="Warnings of Two cameras")).to_contain_text("The capture has 2 cameras")
    refused = card.get_by_role("listitem").filter(has_text="Failed").first
    expect(refused.get_by_role("alert")).to_contain_text(failed["error"]["detail"])
    expect(refused.get_by_role("button", name="Delete job of Two cameras")).to_be_visible()
    for row in (warned, refused):
        expect(row.get_by_role("button", name="Retry Two cameras")).to_have_count(0)
        expect(row.get_by_role("button", name="Cancel Two cameras")).to_have_count(0)


def test_detectors_that_are_not_installed_are_not_offered(page: Page, served: Served) -> None:
    known = served.client.get("/v1/options").raise_for_status().json()["detectors"]
    assert known[0]["installed"] is True
    page.get_by_text("Customise", exact=True).click()
    options = page.locator("select[name=send-detector] option")
    offered = options.evaluate_all("all => all.map(one => one.value)")
    assert offered == ["auto", *(one["name"] for one in known if one["installed"])]


def make_key(data_dir: Path, *options: str) -> str:
    command = [sys.executable, "-m", "api.cli.main", "keys", "create", "portal", "--tenant", "studio", "--json"]
    made = subprocess.run([*command, "--data", str(data_dir), *options], capture_output=True, text=True, check=True)
    return str(json.loads(made.stdout)["key"])


@pytest.mark.slow
def test_with_keys_browser_has_to_show_one(tmp_path: Path) -> None:
    secret, reading = make_key(tmp_path), make_key(tmp_path, "--scope", "read")
    with serving(tmp_path, 1) as served, opened(str(served.client.base_url), allowed=("401 (Unauthorized",)) as page:
        sending = page.get_by_role("heading", name="New capture", level=1)
        expect(page.get_by_role("heading", name="Sign in")).to_be_visible()
        expect(sending).to_be_hidden()
        page.get_by_label("Key").fill("mc_wrong")
        page.get_by_role("button", name="Sign in").click()
        expect(page.get_by_role("alert")).to_contain_text("not known")
        page.get_by_label("Key").fill(secret)
        page.get_by_role("button", name="Sign in").click()
        expect(sending).to_be_visible()
        expect(page.get_by_text("portal, studio")).to_be_visible()
        page.reload()
        expect(sending).to_be_visible()
        assert page.evaluate("document.cookie") == ""
        page.get_by_role("button", name="Sign out").click()
        expect(page.get_by_role("heading", name="Sign in")).to_be_visible()
        page.reload()
        expect(page.get_by_role("heading", name="Sign in")).to_be_visible()
        page.get_by_label("Key").fill(reading)
        page.get_by_role("button", name="Sign in").click()
        # A key that may only read sees captures and can send none.
        page.goto("/#/captures")
        expect(page.get_by_text("No captures yet")).to_be_visible()
        expect(page.get_by_role("link", name="New capture")).to_have_count(0)


@pytest.mark.slow
def test_contract_is_shown_without_other_hosts(served: Served) -> None:
    asked, refused = set(), []
    with opened(str(served.client.base_url)) as page:
        page.on("request", lambda request: asked.add(urlsplit(request.url).netloc))
        page.on("console", lambda message: refused.append(message.text) if message.type == "error" else None)
        page.get_by_role("link", name="Web API").click()
        expect(page.get_by_text("Reconstruct a session", exact=True)).to_be_visible(timeout=180_000)
        page.get_by_role("button", name="GET /healthz Check that").click()
        page.get_by_role("button", name="Try it out").click()
        page.get_by_role("button", name="Execute").click()
        expect(page.locator(".live-responses-table .response-col_status").last).to_contain_text("200")
    assert asked == {served.client.base_url.netloc.decode()}
    assert refused == []  # requests refused by the Content-Security-Policy
