"""Words of the page: boards by fields, calibrations by name and day, times of takes, keys, pictures of captures."""

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import av
import pytest
from playwright.sync_api import Locator, Page, expect

from pipeline.calibration.board.spec import parse_board
from pipeline.calibration.write import encode
from pipeline.core.runtime.packages.samples import Sample
from tests.e2e.browsing import axe_findings, opened
from tests.e2e.captures import cameras_of_two_videos, two_videos
from tests.e2e.serving import Served, serving

# The tests of the page share a service.
pytestmark = pytest.mark.xdist_group("page")


@pytest.fixture
def page(served: Served) -> Iterator[Page]:
    with opened(f"{served.client.base_url}#/calibrations", allowed=("422 (Unprocessable",)) as page:
        yield page


def store(served: Served, name: str, turn_rad: float) -> str:
    spec = ("spec", (None, json.dumps({"method": "file", "name": name}).encode(), "application/json"))
    parts: list[tuple[str, Any]] = [spec, ("calibration", ("rig.json", encode(cameras_of_two_videos(turn_rad))))]
    return str(served.client.post("/v1/calibrations", files=parts).raise_for_status().json()["id"])


def card(page: Page, name: str) -> Locator:
    return page.get_by_role("listitem").filter(has=page.get_by_role("heading", name=name, exact=True, level=2))


@pytest.mark.slow
def test_equal_calibrations_are_listed_once_dated_and_renamed(page: Page, served: Served) -> None:
    other = store(served, "Hall", 0.41)
    first, again = store(served, "Studio", 0.43), store(served, "Studio, again", 0.43)
    page.reload()
    studio = card(page, "Studio, again")
    expect(studio.get_by_text("stored 2 times")).to_be_visible(timeout=180_000)
    expect(studio.get_by_text(re.compile("^today, "))).to_be_visible()
    expect(card(page, "Studio")).to_have_count(0)
    page.get_by_role("button", name="Rename Studio, again").click()
    expect(page.get_by_label("New name of Studio, again")).to_be_focused()
    page.keyboard.type("Studio <i>B</i>")
    page.keyboard.press("Enter")
    expect(page.get_by_role("button", name="Rename Studio <i>B</i>")).to_be_focused(timeout=180_000)
    assert served.client.get(f"/v1/calibrations/{again}").json()["name"] == "Studio <i>B</i>"
    page.get_by_role("link", name="New capture").click()
    options = page.get_by_label("Stored calibration")
    expect(options).to_contain_text("Studio <i>B</i> (", timeout=180_000)
    named = [text for text in options.locator("option").all_inner_texts() if text.startswith(("Studio", "Hall"))]
    assert [re.sub(r" \(.*20\d\d.*\)$", "", text) for text in named] == ["Studio <i>B</i>", "Hall"]
    page.get_by_role("link", name="Calibrations", exact=True).click()
    page.get_by_role("button", name="Delete Studio <i>B</i>").click()
    expect(page.get_by_role("dialog")).to_contain_text("It is stored 2 times. All copies are deleted.")
    page.get_by_role("dialog").get_by_role("button", name="Delete the calibration").click()
    expect(card(page, "Studio <i>B</i>")).to_have_count(0, timeout=180_000)
    assert [served.client.get(f"/v1/calibrations/{each}").status_code for each in (first, again, other)] == [
        *(404, 404, 200)
    ]


def test_board_fields_show_its_picture(page: Page, tmp_path: Path) -> None:
    """The request has the specification of the board that the picture shows."""
    paths = two_videos(tmp_path)
    page.get_by_label("From").select_option("board")
    picture = page.get_by_role("img", name=re.compile("Picture of the board"))
    expect(picture).to_have_accessible_name("Picture of the board: 7 x 5 squares, 420 x 300 mm")
    assert picture.locator("rect.ink").count() == 35  # 18 black squares and 17 markers
    assert axe_findings(page) == []
    page.get_by_label("Kind of board").select_option("chessboard")
    page.get_by_label("Inner corners across").fill("9")
    page.get_by_label("Inner corners down").fill("6")
    page.get_by_label("Square side, mm").fill("37.5")
    expect(picture).to_have_accessible_name("Picture of the board: 10 x 7 squares, 375 x 262.5 mm")
    assert picture.locator("circle").count() == 54
    sent: list[dict[str, Any]] = []
    page.route(
        "**/v1/calibrations",
        lambda route: (
            sent.append(route.request.post_data_json) if route.request.method == "POST" else route.continue_()
        ),
    )
    page.get_by_label("Videos, one a camera").set_input_files([paths["left.mp4"], paths["right.mp4"]])
    page.get_by_role("button", name="Add").click()
    for _ in range(1200):
        if sent:
            break
        page.wait_for_timeout(50)
    board = parse_board(sent[0]["board"])
    assert (board.kind, board.cols, board.rows, board.square_m) == ("chessboard", 9, 6, 0.0375)


@pytest.mark.slow
def test_clocks_are_measured_at_start_of_videos(page: Page, tmp_path: Path) -> None:
    paths = two_videos(tmp_path)
    page.goto("/#/new")
    page.get_by_label("Choose files").set_input_files([*paths.values()])
    expect(page.get_by_label("Camera of left.mp4")).to_have_value("left", timeout=180_000)
    page.get_by_label("The videos start", exact=True).select_option("Unknown: measure from people and sound")
    expect(page.get_by_label("Synchronisation")).to_have_count(0)
    with page.expect_request("**/v1/sessions", timeout=180_000) as asked:
        page.get_by_role("button", name="Send and check only").click()
    body: Any = asked.value.post_data_json
    manifest = body["manifest"]
    assert (manifest["clock"], manifest["sync"]) == ("declared", "auto")


@pytest.mark.slow
def test_time_of_take_is_estimated_from_frames(page: Page, served: Served, sample: Sample) -> None:
    videos = list(sample.videos.values())
    page.goto("/#/new")
    page.get_by_label("Choose files").set_input_files([*videos, sample.calibration])
    tile = page.locator(".tile").filter(has=page.locator("[value=fast]"))
    expect(tile).to_contain_text(re.compile("less than a minute|about .* min"), timeout=180_000)
    assert "MoveNet" not in page.get_by_role("main").inner_text()
    expect(page.get_by_role("region", name="Send")).to_contain_text(re.compile("Takes .*, estimated f(rom|or) "))
    counts = page.evaluate(
        """async () => {
          const { countFrames } = await import("/portal/shared/mp4.js");
          const { sending } = await import("/portal/send/sending.js");
          return Promise.all(sending.rows.map(({ file }) => countFrames(file)));
        }"""
    )
    assert counts == [num_frames(path) for path in videos]
    # Ten times as many frames take ten times as long; the pace is that of jobs of this service.
    minutes = page.evaluate(
        """async () => {
          const { estimateTime } = await import("/portal/shared/jobs.js");
          const { sending } = await import("/portal/send/sending.js");
          const { options } = sending;
          const spec = { profile: "balanced" };
          const job = {
            kind: "reconstruction", state: "succeeded", revision: 0, attempt: 1, spec: { profile: "fast" },
            started_at: "2026-03-01T09:00:00Z", finished_at: "2026-03-01T09:01:00Z",
            stages: [{ unit: "frames", total: 600, reused: false }, { unit: "frames", total: 150, reused: false }],
          };
          const frameS = Object.fromEntries(options.profiles.map(({ name, joints, default_joints: usual }) =>
            [name, joints.find((one) => one.joints === usual).camera_frame_s]));
          const texts = [[6000, [job]], [60000, [job]], [60000, []]].map(([frames, jobs]) => estimateTime(spec, frames, jobs, options).text);
          return [texts, frameS];
        }"""  # noqa: E501
    )
    (texts, frame_s) = minutes
    here_s = 60.0 / (600 * frame_s["fast"]) * frame_s["balanced"]  # seconds a frame of `balanced` on this service
    assert texts == [roughly(6000 * here_s), roughly(60000 * here_s), roughly(60000 * frame_s["balanced"])]


def roughly(seconds: float) -> str:
    return f"about {round(seconds / 60)} min" if seconds < 5400 else f"about {round(seconds / 3600)} h"


def num_frames(path: Path) -> int:
    with av.open(str(path)) as container:
        return container.streams.video[0].frames


@pytest.mark.slow
def test_captures_have_picture(page: Page, served: Served, tmp_path: Path) -> None:
    paths = two_videos(tmp_path)
    files = [("videos", (name, paths[name].read_bytes())) for name in ("left.mp4", "right.mp4")]
    files += [("calibration", ("calibration.json", paths["calibration.json"].read_bytes()))]
    manifest = ("manifest", (None, b'{"name": "Pictured"}'))
    served.client.post("/v1/sessions", files=[*files, manifest]).raise_for_status()
    page.goto("/#/captures")
    picture = card(page, "Pictured").get_by_role("img", name="Pictured, seen by left")
    picture.scroll_into_view_if_needed(timeout=180_000)
    for _ in range(600):
        if picture.evaluate("(image) => image.complete && image.naturalWidth > 0"):
            break
        page.wait_for_timeout(50)
    assert picture.evaluate("(image) => image.naturalWidth") > 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("typed", "answer"),
    [
        ("letmein", "does not begin with mc_"),
        ("mc_short", "has 5 after mc_"),
        ("mc_" + "a" * 43, "the key is of another service or was revoked"),
    ],
)
def test_wrong_key_shows_form_of_keys(locked: Served, typed: str, answer: str) -> None:
    with opened(str(locked.client.base_url), allowed=("401 (Unauthorized",)) as page:
        page.get_by_label("Key").fill(typed)
        page.get_by_role("button", name="Sign in").click()
        expect(page.get_by_role("alert")).to_contain_text(
            "A key is mc_ and 43 letters, digits, - or _", timeout=180_000
        )
        expect(page.get_by_role("alert")).to_contain_text(answer)


@pytest.fixture(scope="module")
def locked(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """Service that asks for a key; keys look as the page says."""
    folder = tmp_path_factory.mktemp("locked")
    command = [sys.executable, "-m", "api.cli.main", "keys", "create", "portal", "--tenant", "studio", "--json"]
    made = subprocess.run([*command, "--data", str(folder)], capture_output=True, text=True, check=True)
    assert re.fullmatch(r"mc_[\w-]{43}", json.loads(made.stdout)["key"])
    with serving(folder, 1) as running:
        yield running
