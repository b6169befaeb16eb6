"""Views Send and Watch in a real browser, on captures of keypoints, which take seconds."""

import base64
import json
import re
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import pytest
from playwright.sync_api import Locator, Page, Request, expect

from tests.cases import slow_but
from tests.e2e.browsing import axe_findings, choose_option, opened
from tests.e2e.captures import keypoint_capture, video_capture
from tests.e2e.serving import Served
from tests.e2e.test_serve_keypoints import archives
from tests.pipeline.media import write_video

# The tests of the page share a service.
pytestmark = pytest.mark.xdist_group("page")

DROP = """([target, files]) => {
  const transfer = new DataTransfer();
  for (const [name, content] of files) {
    const bytes = Uint8Array.from(atob(content), (letter) => letter.charCodeAt(0));
    transfer.items.add(new File([bytes], name, { lastModified: 1 }));
  }
  for (const type of ["dragover", "drop"]) {
    target.dispatchEvent(new DragEvent(type, { dataTransfer: transfer, bubbles: true, cancelable: true }));
  }
}"""


@pytest.fixture(scope="module")
def keypoints(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Files of a capture of keypoints by name: a zip a camera, timestamps, calibration."""
    folder = tmp_path_factory.mktemp("keypoints")
    keypoint_capture(folder)
    for _, (name, content) in archives(folder):
        (folder / name).write_bytes(content)
    return {path.name: path for path in sorted(folder.iterdir()) if path.suffix in {".zip", ".csv", ".json"}}


@pytest.fixture
def page(served: Served) -> Iterator[Page]:
    with opened(f"{served.client.base_url}#/new") as page:
        yield page


def card(page: Page, name: str) -> Locator:
    return page.get_by_role("listitem").filter(has=page.get_by_role("heading", name=name, exact=True, level=2))


def latest(page: Page) -> Locator:
    return page.get_by_role("region", name="Recent jobs").get_by_role("listitem").first


def bottom(part: Locator) -> float:
    box = part.bounding_box()
    assert box is not None
    return box["y"] + box["height"]


def post_session(served: Served, files: dict[str, Path], name: str) -> dict[str, Any]:
    parts = [("keypoints", (one.name, one.read_bytes())) for one in files.values() if one.suffix == ".zip"]
    parts += [("calibration", ("calibration.json", files["calibration.json"].read_bytes()))]
    parts += [("timestamps", ("timestamps.csv", files["timestamps.csv"].read_bytes()))]
    manifest = ("manifest", (None, json.dumps({"name": name}).encode()))
    answer = served.client.post("/v1/sessions", files=[*parts, manifest]).raise_for_status()
    return dict(answer.json())


def test_dropped_files_become_capture_with_files_to_download(page: Page, keypoints: dict[str, Path]) -> None:
    files = [(name, base64.b64encode(path.read_bytes()).decode()) for name, path in keypoints.items()]
    page.evaluate(DROP, [page.get_by_text("Drop one video").element_handle(), files])
    expect(page.get_by_label("Camera of cam_01.zip")).to_have_value("cam_01", timeout=180_000)
    page.get_by_label("Name of the capture").fill("Dropped")
    send = page.get_by_role("button", name="Send and reconstruct")
    assert bottom(send) <= 800
    page.get_by_role("radio", name="Unreal Engine").check()
    send.click()
    # The page of the new job opens.
    expect(page).to_have_url(re.compile("#/jobs/"), timeout=180_000)
    expect(page.get_by_role("heading", name="Dropped", level=1)).to_be_visible()
    expect(page.get_by_text("Done").first).to_be_visible(timeout=120_000)
    with page.expect_download() as download:
        page.get_by_role("link", name=re.compile(r"\.bvh")).first.click()
    assert download.value.path().read_text().startswith("HIERARCHY\nROOT pelvis")
    # Ready for the next take: the same cameras and choices, no files.
    page.get_by_role("link", name="New capture").click()
    expect(latest(page)).to_contain_text("Dropped")
    expect(page.get_by_text("Drop one video")).to_be_visible()
    expect(page.get_by_label("Stored calibration")).not_to_have_value("")
    expect(page.get_by_role("radio", name="Unreal Engine")).to_be_checked()
    # Files of one's own choice are for no purpose of the list.
    page.get_by_text("Customise", exact=True).click()
    page.get_by_role("checkbox", name="GLB, body and animation").check()
    expect(page.get_by_role("group", name="The take is for").get_by_role("radio", checked=True)).to_have_count(0)
    page.get_by_role("radio", name="Web pages").check()
    expect(page.get_by_role("checkbox", name="GLB, body and animation")).to_be_checked()
    expect(page.get_by_role("checkbox", name="FBX, body and animation")).not_to_be_checked()
    expect(page.get_by_label("Target application", exact=True)).to_have_value("default")


@pytest.mark.slow
def test_another_run_uploads_nothing(page: Page, served: Served, keypoints: dict[str, Path]) -> None:
    session = post_session(served, keypoints, "Twice")
    first = served.client.post(session["urls"]["jobs"], json={"frame_range": [0, 20]}).raise_for_status().json()
    uploads: list[Request] = []
    page.on("request", lambda request: uploads.append(request) if "/uploads" in request.url else None)
    page.get_by_role("link", name="Captures", exact=True).click()
    twice = card(page, "Twice")
    twice.get_by_role("button", name="Run again: Twice").click()
    form = page.get_by_role("form", name="Run Twice again")
    # The form begins with the choices of the last job.
    form.get_by_text("Customise").click()
    expect(form.get_by_label("after the last")).to_have_value("20")
    form.get_by_role("radio", name="Blender").check()
    with page.expect_response("**/v1/sessions/*/jobs") as answer:
        form.get_by_role("button", name="Reconstruct without uploading").click()
    made = answer.value.json()
    assert (made["spec"]["preset"], made["spec"]["frame_range"]) == ("blender", [0, 20])
    assert made["session_id"] == session["id"]
    assert made["id"] != first["id"]
    expect(twice.get_by_text("Blender")).to_be_visible()
    expect(page.get_by_role("button", name="Run again: Twice")).to_be_focused()
    for job in (first["id"], made["id"]):
        assert served.wait_for_end(job)["state"] == "succeeded"
    for name in ("Open Twice, run 1", "Open Twice, run 2"):
        expect(twice.get_by_role("link", name=name)).to_be_visible(timeout=180_000)
    assert uploads == []


@pytest.mark.slow
def test_captures_are_searched_renamed_and_deleted(page: Page, served: Served, keypoints: dict[str, Path]) -> None:
    for name in ("Walk A", "Walk B"):
        post_session(served, keypoints, name)
    page.get_by_role("link", name="Captures", exact=True).click()
    page.get_by_label("Search by name").fill("walk")
    expect(page.get_by_role("heading", level=2)).to_have_text(["Walk B", "Walk A"])
    page.get_by_role("button", name="Rename Walk A").click()
    expect(page.get_by_label("New name of Walk A")).to_be_focused()
    page.keyboard.type("Walk <i>C</i>")
    page.keyboard.press("Enter")
    expect(page.get_by_role("button", name="Rename Walk <i>C</i>")).to_be_focused()
    expect(page.get_by_role("status").first).to_contain_text("Renamed to Walk <i>C</i>.")
    delete = page.get_by_role("button", name="Delete Walk B")
    delete.focus()
    page.keyboard.press("Enter")
    expect(page.get_by_role("dialog").get_by_role("button", name="Keep")).to_be_focused()
    page.keyboard.press("Escape")
    expect(delete).to_be_focused()
    page.keyboard.press("Enter")
    page.get_by_role("dialog").get_by_role("button", name="Delete the capture").press("Enter")
    expect(page.get_by_role("heading", level=2)).to_have_text(["Walk <i>C</i>"])
    expect(page.get_by_role("heading", name="Captures", level=1)).to_be_focused()
    names = [one["name"] for one in served.client.get("/v1/sessions?name=walk").json()["sessions"]]
    assert names == ["Walk <i>C</i>"]


@pytest.mark.slow
def test_videos_are_deleted_and_results_stay(page: Page, served: Served, tmp_path: Path) -> None:
    video_capture(tmp_path, 5)
    files = [("videos", (path.name, path.read_bytes())) for path in sorted((tmp_path / "videos").iterdir())]
    files += [("calibration", ("calibration.json", (tmp_path / "calibration.json").read_bytes()))]
    documents = [("manifest", (None, b'{"name": "Private room"}')), ("spec", (None, b'{"blur_faces": true}'))]
    job = served.client.post("/v1/jobs", files=[*files, *documents]).raise_for_status().json()
    assert served.wait_for_end(job["id"])["state"] == "succeeded"
    page.get_by_role("link", name="Captures", exact=True).click()
    shown = card(page, "Private room")
    expect(shown).to_contain_text("faces blurred")
    shown.get_by_role("button", name="Delete videos of Private room").click()
    dialog = page.get_by_role("dialog")
    expect(dialog).to_contain_text("Results stay")
    dialog.get_by_role("button", name="Delete the videos").click()
    expect(page.get_by_role("status").first).to_contain_text("The videos of Private room are deleted.")
    expect(shown).to_contain_text("videos deleted")
    expect(shown.get_by_role("button", name="Delete videos of Private room")).to_have_count(0)
    session = served.client.get(f"/v1/sessions/{job['session_id']}").raise_for_status().json()
    assert (session["videos_deleted_at"] is not None, session["shows_blurred"]) == (True, True)
    # The viewer shows the blurred copies.
    camera = session["preflight"]["cameras"][0]
    assert served.client.get(camera["video_url"]).raise_for_status().headers["content-type"] == "video/mp4"
    page.goto(f"{served.client.base_url}#/jobs/{job['id']}")
    files_shown = page.get_by_role("region", name="Files")
    expect(files_shown.get_by_text("Video with blurred heads").first).to_be_visible()


@pytest.mark.slow
def test_nobody_found_is_no_plain_success(page: Page, served: Served, tmp_path: Path) -> None:
    video_capture(tmp_path, 5)
    files = [("videos", (path.name, path.read_bytes())) for path in sorted((tmp_path / "videos").iterdir())]
    files += [("calibration", ("calibration.json", (tmp_path / "calibration.json").read_bytes()))]
    manifest = ("manifest", (None, b'{"name": "Empty room"}'))
    job = served.client.post("/v1/jobs", files=[*files, manifest]).raise_for_status().json()
    ended = served.wait_for_end(job["id"])
    page.get_by_role("link", name="Captures", exact=True).click()
    row = card(page, "Empty room").locator(".job")
    state = row.locator(".state")
    expect(state).to_have_text("Done: no person found")
    expect(state).to_have_attribute("data-tone", "empty")
    warning = ended["warnings"][-1]["message"]
    expect(row.get_by_role("list", name="Warnings of Empty room")).to_contain_text(warning)


def test_incomplete_capture_is_not_sent(page: Page, keypoints: dict[str, Path]) -> None:
    sent: list[str] = []
    page.on("request", lambda request: sent.append(request.url) if request.method == "POST" else None)
    page.get_by_label("Choose files").set_input_files([keypoints["cam_00.zip"]])
    page.get_by_role("button", name="Send and reconstruct").click()
    problem = page.get_by_role("region", name="Send").get_by_role("alert")
    expect(problem).to_contain_text("Add the videos of at least 2 cameras.")
    expect(problem).to_contain_text("Choose or add a calibration.")
    assert sent == []


@pytest.mark.slow
def test_cameras_are_corrected_and_left_out(page: Page, served: Served, keypoints: dict[str, Path]) -> None:
    page.get_by_label("Choose files").set_input_files(list(keypoints.values()))
    first, second = page.get_by_label("Camera of cam_00.zip"), page.get_by_label("Camera of cam_01.zip")
    expect(first).to_have_value("cam_00", timeout=180_000)
    first.select_option("cam_01")
    page.get_by_role("button", name="Send and check only").click()
    expect(page.get_by_role("region", name="Send").get_by_role("alert")).to_contain_text("One camera has several files")
    second.select_option("cam_00")
    page.get_by_label("Use cam_02.zip").uncheck()
    page.get_by_label("Name of the capture").fill("Exchanged")
    with page.expect_response("**/v1/sessions") as answer:
        page.get_by_role("button", name="Send and check only").click()
    cameras = {one["name"]: one["file"] for one in answer.value.json()["preflight"]["cameras"]}
    assert set(cameras) == {"cam_00", "cam_01"}
    sizes = {one["name"]: one["num_bytes"] for one in answer.value.json()["files"]}
    assert sizes[cameras["cam_01"]] == keypoints["cam_00.zip"].stat().st_size
    # The statements of the check stand there, also after a reload, and the capture can be discarded.
    expect(page.get_by_role("heading", name="Check", exact=True)).to_be_visible()
    page.reload()
    page.get_by_role("button", name="Discard the capture").click()
    expect(page.get_by_text("Drop one video")).to_be_visible()
    assert served.client.get("/v1/sessions?name=Exchanged").json()["sessions"] == []


@pytest.mark.parametrize(("width", "scheme"), slow_but([(390, "dark")], [(1280, "light"), (390, "dark")]))
def test_views_are_accessible_and_fit(
    served: Served, keypoints: dict[str, Path], width: int, scheme: Literal["light", "dark"]
) -> None:
    job = one_job(served, keypoints)
    views = {"#/new": "New capture", "#/captures": "Captures", "#/calibrations": "Calibrations", "#/live": "Live"}
    views["#/record"] = "Record"
    views[f"#/jobs/{job['id']}"] = job["session_name"]
    with opened(str(served.client.base_url), {"width": width, "height": 800}) as page:
        page.emulate_media(color_scheme=scheme, reduced_motion="reduce")
        for view, title in views.items():
            page.goto(f"/{view}")
            expect(page.get_by_role("heading", name=title, exact=True, level=1)).to_be_visible()
            if view == "#/new":
                page.get_by_label("Choose files").set_input_files(list(keypoints.values()))
                expect(page.get_by_label("Camera of cam_00.zip")).to_have_value("cam_00", timeout=180_000)
                page.get_by_role("button", name="Send and check only").scroll_into_view_if_needed()
            if view == "#/captures":
                page.get_by_role("button", name="Run again").first.click()
                page.get_by_role("button", name="Other calibration").first.click()
            page.locator("details").evaluate_all("all => all.forEach((one) => { one.open = true; })")
            assert axe_findings(page) == [], view
            assert page.evaluate("document.scrollingElement.scrollWidth") <= width, view


def one_job(served: Served, keypoints: dict[str, Path]) -> dict[str, Any]:
    """Finished job."""
    done = served.client.get("/v1/jobs?state=succeeded").json()["jobs"]
    if done:
        return dict(done[0])
    urls = post_session(served, keypoints, "Accessible")["urls"]
    job = served.client.post(urls["jobs"], json={"frame_range": [0, 20]}).raise_for_status().json()
    return served.wait_for_end(job["id"])


# Text of the focused element, and whether it or its frame has an outline.
FOCUS = """() => {
  const one = document.activeElement;
  const parts = [one, one.closest(".button, .tile") ?? one];
  const isSeen = parts.some((part) => ["solid", "auto"].includes(getComputedStyle(part).outlineStyle));
  return [one.innerText || one.labels?.[0]?.innerText || one.name, isSeen];
}"""


def test_keyboard_reaches_everything_in_order(page: Page) -> None:
    """From the skip link to the button that sends: no trap, and the focus is visible."""
    expect(page.get_by_role("radio", name="Blender")).to_be_visible()
    page.keyboard.press("Tab")
    expect(page.get_by_role("link", name="Skip to the content")).to_be_focused()
    page.keyboard.press("Enter")
    expect(page.get_by_role("main")).to_be_focused()
    seen: list[str] = []
    for _ in range(60):
        page.keyboard.press("Tab")
        focus = page.evaluate(FOCUS)
        assert focus[1], f"the focus on {focus[0]} is not visible"
        seen.append(focus[0])
        if focus[0] == "Send and reconstruct":
            break
    order = [
        next(i for i, text in enumerate(seen) if part in text)
        for part in ("Choose files", "Choose a folder", "Try the")
    ]
    assert order == sorted(order)
    assert seen[-1] == "Send and reconstruct"


def test_zips_are_told_apart(page: Page, keypoints: dict[str, Path], tmp_path: Path) -> None:
    """A zip of images is a camera's video, one of keypoints its keypoints, one of other files a calibration."""
    script = """async () => {
      const { detectKind } = await import("/portal/send/files.js");
      const files = document.querySelector("#probe").files;
      return Promise.all(Array.from(files, detectKind));
    }"""
    paths = [keypoints["cam_00.zip"]]
    for name, entries in (("images", ["a/0001.PNG", "a/0002.PNG"]), ("colmap", ["cameras.txt", "images.txt"])):
        paths.append(tmp_path / f"{name}.zip")
        with zipfile.ZipFile(paths[-1], "w") as archive:
            for entry in entries:
                archive.writestr(entry, b"content")
    page.evaluate(
        "Object.assign(document.body.appendChild(document.createElement('input')), { type: 'file', id: 'probe' })"
    )
    page.evaluate("document.getElementById('probe').multiple = true")
    page.locator("#probe").set_input_files(paths)
    assert page.evaluate(script) == ["keypoints", "video", "calibration"]


@pytest.mark.slow
def test_findings_of_check_stand_beside_their_camera(page: Page, served: Served, tmp_path: Path) -> None:
    video_capture(tmp_path, 5)
    left, right = (tmp_path / "videos" / f"{name}.mp4" for name in ("left", "right"))
    # A frame a second is dropped: the times of the video say so.
    write_video(right, 50, stamps=[40 * (number + number // 24) for number in range(50)])
    page.get_by_label("Choose files").set_input_files([left, right, tmp_path / "calibration.json"])
    expect(page.get_by_label("Camera of left.mp4")).to_have_value("left", timeout=180_000)
    with page.expect_response("**/v1/sessions", timeout=180_000) as answer:
        page.get_by_role("button", name="Send and check only").click()
    findings = [one for one in answer.value.json()["preflight"]["findings"] if one["camera"] == "right"]
    assert findings
    row = page.get_by_role("row").filter(has=page.get_by_label("Camera of right.mp4"))
    beside = row.locator("xpath=following-sibling::tr[1]")
    expect(beside).to_contain_text(findings[0]["message"])
    expect(page.get_by_role("region", name="Send").get_by_text(findings[0]["message"])).to_have_count(0)
    page.get_by_role("button", name="Discard the capture").click()
    expect(page.get_by_text("Drop one video")).to_be_visible()


@pytest.mark.benchmark
def test_first_view_opens_within_second(served: Served) -> None:
    """From the request to the drawn list of captures, with an empty cache, on loopback."""
    with opened("about:blank") as page:
        page.goto(f"{served.client.base_url}#/captures")
        expect(page.get_by_role("heading", name="Captures", level=1)).to_be_visible()
        shown_ms = page.evaluate("Math.max(...performance.getEntries().map((one) => one.responseEnd ?? one.startTime))")
        assert shown_ms <= 1000


@pytest.mark.slow
def test_same_footage_takes_another_calibration(page: Page, served: Served, keypoints: dict[str, Path]) -> None:
    session = post_session(served, keypoints, "Footage")
    content = keypoints["calibration.json"].read_bytes()
    spec = ("spec", (None, json.dumps({"method": "file", "name": "Second"}).encode(), "application/json"))
    stored = served.client.post("/v1/calibrations", files=[spec, ("calibration", ("second.json", content))])
    assert stored.status_code == 201
    page.get_by_role("link", name="Captures", exact=True).click()
    page.get_by_role("button", name="Other calibration: Footage").click()
    form = page.get_by_role("form", name="Other calibration for Footage")
    choose_option(form.get_by_label("Calibration"), "Second")
    form.get_by_label("Name of the new capture").fill("Footage, second")
    form.get_by_role("button", name="Create the new capture").click()
    expect(page.get_by_role("button", name="Reconstruct: Footage, second")).to_be_focused(timeout=180_000)
    (made,) = served.client.get("/v1/sessions?name=Footage, second").json()["sessions"]
    digests = [
        {one["name"]: one["sha256"] for one in each["files"] if one["kind"] == "keypoints"} for each in (made, session)
    ]
    assert digests[0] == digests[1]
