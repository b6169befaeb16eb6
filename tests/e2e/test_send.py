"""Sending a capture: Send in reach, the page of the new job, files that replace refused ones, rates of keypoints."""

import os
import re
from collections.abc import Iterator
from pathlib import Path

import av
import pytest
from playwright.sync_api import Locator, Page, Route, ViewportSize, expect

from tests.e2e.browsing import opened
from tests.e2e.captures import keypoint_capture, two_videos
from tests.e2e.datasets import folder_of, needs
from tests.e2e.serving import Served
from tests.e2e.test_serve_keypoints import archives
from tests.pipeline.media import cut_at_keyframes, write_pictures

# The tests of the page share a service.
pytestmark = pytest.mark.xdist_group("page")

PHONE: ViewportSize = {"width": 390, "height": 800}


@pytest.fixture(scope="module")
def videos(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return two_videos(tmp_path_factory.mktemp("videos"))


@pytest.fixture(scope="module")
def keypoints(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("keypoints")
    keypoint_capture(folder)
    for _, (name, content) in archives(folder):
        (folder / name).write_bytes(content)
    return {path.name: path for path in sorted(folder.iterdir()) if path.suffix in {".zip", ".csv", ".json"}}


@pytest.fixture
def page(served: Served) -> Iterator[Page]:
    with opened(f"{served.client.base_url}#/new", PHONE, allowed=("422 (Unprocessable",)) as page:
        yield page


def choose(page: Page, *paths: Path) -> None:
    page.get_by_label("Choose files").set_input_files(paths)


def send(page: Page) -> Locator:
    return page.get_by_role("button", name="Send and reconstruct")


def is_seen(part: Locator) -> bool:
    """Return whether a part is on the screen as the page stands."""
    box, viewport = part.bounding_box(), part.page.viewport_size
    assert box is not None
    assert viewport is not None
    return box["y"] >= 0 and box["y"] + box["height"] <= viewport["height"]


@pytest.mark.slow
def test_send_is_in_reach_on_phone_and_opens_job(page: Page, videos: dict[str, Path]) -> None:
    assert is_seen(send(page))
    choose(page, *videos.values())
    expect(page.get_by_label("Camera of left.mp4")).to_have_value("left", timeout=180_000)
    expect(page.get_by_role("radio", name="Blender")).to_be_visible()
    for part in ("The videos start", "Stored calibration"):
        page.get_by_label(part, exact=True).scroll_into_view_if_needed()
        assert is_seen(send(page)), part
    page.get_by_label("Name of the capture").fill("From a phone")
    send(page).click()
    expect(page).to_have_url(re.compile("#/jobs/"), timeout=180_000)
    expect(page.get_by_role("heading", name="From a phone", level=1)).to_be_visible()
    assert page.evaluate("scrollY") == 0
    first = page.get_by_role("main").get_by_role("progressbar").first
    if first.count():  # until the job ends
        assert is_seen(first)
    expect(page.get_by_text("Done: no person found")).to_be_visible(timeout=240_000)


@pytest.mark.slow
def test_page_of_running_job_shows_progress_at_once(page: Page, served: Served, videos: dict[str, Path]) -> None:
    worker = served.part("worker")
    tree = [worker, *worker.children(recursive=True)]
    for process in tree:
        process.suspend()
    try:
        choose(page, *videos.values())
        expect(page.get_by_label("Camera of left.mp4")).to_have_value("left", timeout=180_000)
        send(page).click()
        expect(page).to_have_url(re.compile("#/jobs/"), timeout=180_000)
        expect(page.locator(".state").first).to_have_text("Waiting")
        for progress in page.get_by_role("main").get_by_role("progressbar").all():
            assert is_seen(progress)
        assert page.get_by_role("main").get_by_role("progressbar").count() > 0
    finally:
        for process in tree:
            process.resume()


def test_calibration_is_read_after_others_were_checked(served: Served, videos: dict[str, Path]) -> None:
    refusals = [{"code": "too_many_checks", "detail": "Too many of your captures are being checked at once."}]

    def refuse(route: Route) -> None:
        if route.request.method == "POST" and refusals:
            route.fulfill(status=429, json=refusals.pop())
        else:
            route.continue_()

    with opened(f"{served.client.base_url}#/new", PHONE, allowed=("429 (Too Many",)) as page:
        page.route("**/v1/calibrations", refuse)
        expect(send(page)).to_be_visible(timeout=180_000)
        choose(page, *videos.values())
        refused = page.get_by_role("region", name="Send").get_by_role("alert")
        expect(refused).to_contain_text("Too many of your captures are being checked at once.")
        expect(page.locator(".chosen b")).to_be_visible(timeout=180_000)
        expect(refused).to_have_count(0)


@pytest.mark.slow
def test_videos_without_calibration_go_on_in_same_form(page: Page, served: Served, videos: dict[str, Path]) -> None:
    choose(page, videos["left.mp4"], videos["right.mp4"])
    page.get_by_label("Stored calibration").select_option("people")
    height = page.get_by_label("Height of people")
    refusal = page.get_by_role("region", name="Send").get_by_role("alert")
    height.fill("tall")
    send(page).click()
    expect(refusal).to_contain_text("Type heights such as 178 cm, 1.78 or 1,78")
    height.fill("1,78; 165 cm")
    expect(page.get_by_text("Read as 1.78 m, 1.65 m.")).to_be_visible()
    with page.expect_response("**/v1/calibrations", timeout=180_000) as answer:
        send(page).click()
    made = served.client.get(f"/v1/calibrations/{answer.value.json()['id']}").raise_for_status().json()
    assert (made["method"], made["source"]["stature_m"]) == ("people", [1.78, 1.65])
    # A reload does not lose it. No person walks in these videos, so the job fails and says why.
    page.reload()
    expect(page.get_by_text("Calibrating the cameras").or_(refusal).first).to_be_visible(timeout=180_000)
    expect(refusal).to_be_visible(timeout=240_000)
    failed = served.client.get(f"/v1/calibrations/{made['id']}").json()
    assert failed["state"] == "failed"
    expect(refusal).to_contain_text(failed["error"]["detail"])


@needs("rendered")
@pytest.mark.slow
def test_people_calibrate_and_take_is_reconstructed(page: Page, served: Served) -> None:
    """One press of Send: the calibration is made from the people, then the take with it, and later takes have it."""
    choose(page, *sorted((folder_of("rendered") / "videos").iterdir()))
    page.get_by_label("Stored calibration").select_option("people")
    page.get_by_label("Height of people").fill("1,75")
    page.get_by_label("Name of the capture").fill("Without calibration")
    page.get_by_role("radio", name="Fast").check()
    send(page).click()
    expect(page.get_by_text("Calibrating the cameras").first).to_be_visible(timeout=240_000)
    expect(page).to_have_url(re.compile("#/jobs/"), timeout=600_000)
    expect(page.get_by_role("heading", name="Without calibration", level=1)).to_be_visible()
    job = served.wait_for_end(page.url.rpartition("/")[2])
    assert job["state"] == "succeeded", job["error"]
    assert len(served.edits(job["id"])["run"]["found"]) >= 2
    page.get_by_role("link", name="New capture").click()
    expect(page.get_by_label("Stored calibration")).not_to_have_value("")


@pytest.mark.slow
def test_files_of_other_names_are_paired_by_order(page: Page, videos: dict[str, Path], tmp_path: Path) -> None:
    files = [tmp_path / name for name in ("video 9.mp4", "video 10.mp4")]
    for file, video in zip(files, (videos["left.mp4"], videos["right.mp4"]), strict=True):
        file.write_bytes(video.read_bytes())
    choose(page, *files, videos["calibration.json"])
    notice = page.get_by_text("is not clear from the name")
    expect(notice).to_contain_text(
        "video 10.mp4 is not clear from the name. Free cameras: left, right.", timeout=180_000
    )
    cameras = [page.get_by_label(f"Camera of {file.name}") for file in files]
    for camera in cameras:
        expect(camera).to_have_value("")
    page.get_by_role("button", name="Pair by order of names").click()
    expect(cameras[0]).to_have_value("left")
    expect(cameras[1]).to_have_value("right")
    expect(notice).to_be_hidden()


def chapters(videos: dict[str, Path], folder: Path, *names: str) -> list[Path]:
    """Video of the left camera in several files."""
    with av.open(str(videos["left.mp4"])) as container:
        pictures = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    options = {"g": "2", "keyint_min": "2", "sc_threshold": "0", "bf": "0"}
    whole = write_pictures(folder / "whole.mp4", pictures, options)
    return cut_at_keyframes(whole, [folder / name for name in names])


@pytest.mark.slow
def test_chapters_and_stated_parts_are_one_camera(page: Page, videos: dict[str, Path], tmp_path: Path) -> None:
    files = chapters(videos, tmp_path, "left_GX010007.mp4", "left_GX020007.mp4", "left_GX030007.mp4")
    beside = tmp_path / "._left_GX010007.mp4"
    beside.write_bytes(b"\0")
    choose(page, *files, beside, videos["right.mp4"], videos["calibration.json"])
    expect(page.get_by_text("files of systems and cameras: ._left_GX010007.mp4.")).to_be_visible(timeout=180_000)
    for file in files:
        expect(page.get_by_label(f"Camera of {file.name}")).to_have_value("left", timeout=180_000)
    expect(page.get_by_text("part 3 of the video")).to_be_visible()
    expect(page.get_by_label("Offset in seconds of left_GX020007.mp4")).to_have_count(0)
    with page.expect_response("**/v1/sessions") as answer:
        page.get_by_role("button", name="Send and check only").click()
    cameras = {camera["name"]: camera for camera in answer.value.json()["preflight"]["cameras"]}
    assert [cameras["left"]["file"], *cameras["left"]["more_files"]] == [file.name for file in files]
    assert cameras["left"]["num_frames"] == cameras["right"]["num_frames"]
    page.get_by_role("button", name="Discard the capture").click()
    expect(page.get_by_text("Drop one video")).to_be_visible()

    files = chapters(videos, tmp_path, "C0009.mp4", "C0010.mp4")
    choose(page, *files, videos["right.mp4"])
    for file in files:
        page.get_by_label(f"Camera of {file.name}").select_option("left", timeout=180_000)
    join = page.get_by_role("button", name="Join as parts, by name")
    expect(join).to_be_visible()
    page.get_by_role("button", name="Send and check only").click()
    expect(page.get_by_role("region", name="Send").get_by_role("alert")).to_contain_text("One camera has several files")
    join.click()
    expect(join).to_be_hidden()
    expect(page.get_by_text("part 2 of the video")).to_be_visible()
    with page.expect_response("**/v1/sessions") as answer:
        page.get_by_role("button", name="Send and check only").click()
    cameras = {camera["name"]: camera for camera in answer.value.json()["preflight"]["cameras"]}
    assert [cameras["left"]["file"], *cameras["left"]["more_files"]] == ["C0009.mp4", "C0010.mp4"]
    page.get_by_role("button", name="Discard the capture").click()
    expect(page.get_by_text("Drop one video")).to_be_visible()


@pytest.mark.slow
def test_refused_file_is_replaced_by_same_name(
    page: Page, served: Served, videos: dict[str, Path], tmp_path: Path
) -> None:
    broken = tmp_path / "left.mp4"
    broken.write_bytes(b"no video")
    choose(page, broken, videos["right.mp4"], videos["calibration.json"])
    camera, offset = page.get_by_label("Camera of left.mp4"), page.get_by_label("Offset in seconds of left.mp4")
    expect(camera).to_have_value("left", timeout=180_000)
    offset.fill("0.02")
    send(page).click()
    refusal = page.get_by_role("region", name="Send").get_by_role("alert")
    expect(refusal).to_contain_text("left.mp4", timeout=180_000)
    choose(page, videos["left.mp4"])
    expect(page.get_by_text("left.mp4 replaces the file of this name.")).to_be_visible()
    expect(refusal).to_have_count(0)
    # The statements about the camera stay.
    expect(camera).to_have_value("left")
    expect(offset).to_have_value("0.02")
    with page.expect_response("**/v1/sessions/*/jobs", timeout=180_000) as answer:
        send(page).click()
    files = served.client.get(answer.value.json()["urls"]["session"]).json()["files"]
    sizes = {one["name"]: one["num_bytes"] for one in files}
    assert sizes["left.mp4"] == videos["left.mp4"].stat().st_size


def test_two_files_of_one_name_are_not_mixed(page: Page, videos: dict[str, Path], tmp_path: Path) -> None:
    other = tmp_path / "left.mp4"
    other.write_bytes(b"another camera of this name")
    choose(page, videos["left.mp4"], other)
    expect(page.get_by_text("Two files have the name left.mp4.")).to_be_visible()
    expect(page.get_by_label("Use left.mp4")).to_have_count(1)


@pytest.mark.slow
def test_keypoints_without_timestamps_need_frame_rate(page: Page, served: Served, keypoints: dict[str, Path]) -> None:
    timestamps = keypoints["timestamps.csv"]
    rate = page.get_by_label("Frame rate of keypoints, Hz")
    choose(page, *(path for path in keypoints.values() if path != timestamps))
    expect(page.get_by_label("Camera of cam_00.zip")).to_have_value("cam_00", timeout=180_000)
    expect(rate).to_have_value("")
    send(page).click()
    refusal = page.get_by_role("region", name="Send").get_by_role("alert")
    expect(refusal).to_contain_text("Type the frame rate of the keypoints")
    # Timestamps do instead.
    choose(page, timestamps)
    expect(rate).to_have_count(0)
    page.get_by_label("Use timestamps.csv").uncheck()
    rate.fill("50")
    with page.expect_response("**/v1/sessions", timeout=180_000) as answer:
        page.get_by_role("button", name="Send and check only").click()
    session = answer.value.json()
    assert session["preflight"]["timebase"]["frame_rate_hz"] == 50
    assert "frame_rate_assumed" not in {one["code"] for one in session["preflight"]["findings"]}
    # Files of a capture that was checked are changed without choosing them again.
    page.get_by_role("button", name="Change the files").click()
    rate.fill("25")
    with page.expect_response("**/v1/sessions", timeout=180_000) as answer:
        page.get_by_role("button", name="Send and check only").click()
    assert answer.value.json()["preflight"]["timebase"]["frame_rate_hz"] == 25
    assert served.client.get(session["urls"]["self"]).status_code == 404
    page.get_by_role("button", name="Discard the capture").click()


def write_takes(folder: Path, videos: dict[str, Path]) -> Path:
    """Folder with the takes "run" (which lacks a video), "take 9" and "take 10", and the calibration of all."""
    for take in ("take 10", "take 9", "run"):
        (folder / take).mkdir(parents=True)
        for name in ("left.mp4", "right.mp4"):
            (folder / take / name).write_bytes(videos[name].read_bytes())
            os.utime(folder / take / name, (0, 0))  # files of takes may be alike but for their folders
    (folder / "run" / "right.mp4").unlink()
    (folder / "calibration.json").write_bytes(videos["calibration.json"].read_bytes())
    return folder


@pytest.mark.slow
def test_folder_of_takes_is_sent_take_by_take(
    page: Page, served: Served, videos: dict[str, Path], tmp_path: Path
) -> None:
    folder = write_takes(tmp_path / "day", videos)
    page.get_by_label("Choose a folder").set_input_files(folder)
    page.get_by_role("button", name="They are 3 captures").click(timeout=180_000)
    page.get_by_role("button", name="Send and reconstruct 3 captures").click(timeout=180_000)
    takes = page.get_by_role("list", name="Captures to send").get_by_role("listitem")
    run, ninth, tenth = (takes.filter(has_text=name) for name in ("run", "take 9", "take 10"))
    expect(run).to_contain_text("Add the videos of at least 2 cameras.", timeout=180_000)
    for row in (ninth, tenth):
        expect(row.locator(".state")).not_to_have_text("waits", timeout=180_000)
        assert row.locator(".state").inner_text() == "sent", row.inner_text()
    expect(page.get_by_role("heading", name="3 captures, 2 sent")).to_be_visible()
    jobs = [row.get_by_role("link").get_attribute("href") for row in (ninth, tenth)]
    assert len({*jobs}) == 2

    # The folder is chosen again after a reload: nothing is sent twice, and the take that was mended is sent alone.
    page.reload()
    (folder / "run" / "right.mp4").write_bytes(videos["right.mp4"].read_bytes())
    page.get_by_label("Choose a folder").set_input_files(folder)
    page.get_by_role("button", name="They are 3 captures").click(timeout=180_000)
    expect(ninth.locator(".state")).to_have_text("sent before", timeout=180_000)
    assert [row.get_by_role("link").get_attribute("href") for row in (ninth, tenth)] == jobs
    send(page).click(timeout=180_000)
    expect(run.locator(".state")).to_have_text("sent", timeout=180_000)
    expect(page.get_by_role("heading", name="3 captures, 3 sent")).to_be_visible()
    for row in (run, ninth, tenth):
        link = row.get_by_role("link").get_attribute("href") or ""
        assert served.wait_for_end(link.removeprefix("#/jobs/"))["state"] == "succeeded"
