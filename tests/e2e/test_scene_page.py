"""Page of known points: marks by mouse and keys in a video and a picture, errors named, the calibration stored."""

import os
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from playwright.sync_api import Locator, Page, ViewportSize, expect

from pipeline.calibration.write import encode
from pipeline.core.data.cameras import Camera
from pipeline.geometry.camera import center_in_world, project
from pipeline.validation.simulation.rigs import Layout, Rig, build_cameras
from tests.e2e.browsing import axe_findings, opened
from tests.e2e.serving import Served
from tests.pipeline.media import write_pictures

# All tests of the page share one service.
pytestmark = pytest.mark.xdist_group("page")

CAMERAS = build_cameras(Rig(Layout.RING, 2, (3.0, 2.5), 2.0, distortion=(0.0,) * 5), np.random.default_rng(0))
CORNERS_M = [(x, y, z + 0.2 * x) for x in (0.0, 0.8) for y in (0.0, 0.6) for z in (0.3, 1.2)]
TABLE = "name; x; y; z\n" + "\n".join(f"P{k}; {x}; {y:.1f}; {z:.2f}" for k, (x, y, z) in enumerate(CORNERS_M))
PHONE: ViewportSize = {"width": 390, "height": 800}
# The check is a program of its own, which waits for a processor.
WAIT_MS = 180_000
# A folder for pictures of the page, to look at.
LOOK = os.environ.get("MULTICAP_LOOK")


def pixels(camera: Camera) -> np.ndarray:
    return np.asarray(project(camera, np.array(CORNERS_M)))


def painted(camera: Camera) -> np.ndarray:
    """Picture with a cross at each corner, and the edges of the box."""
    width, height = camera.size_px
    picture = np.full((height, width, 3), (90, 100, 96), np.uint8)
    picture[height // 2 :] = (120, 128, 124)
    corners = np.round(pixels(camera)).astype(int)
    for first, second in (
        (0, 1),
        (2, 3),
        (4, 5),
        (6, 7),
        (0, 2),
        (1, 3),
        (4, 6),
        (5, 7),
        (0, 4),
        (1, 5),
        (2, 6),
        (3, 7),
    ):
        cv2.line(picture, corners[first].tolist(), corners[second].tolist(), (60, 70, 200), 3)
    for corner in corners:
        cv2.drawMarker(picture, corner.tolist(), (255, 255, 255), cv2.MARKER_CROSS, 15)
    return picture


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """A video of the first camera, and a picture of the second."""
    folder = tmp_path_factory.mktemp("scene")
    first, second = (painted(camera) for camera in CAMERAS)
    cv2.imwrite(str(folder / "cam_01.png"), second)
    return [write_pictures(folder / "cam_00.mp4", [first] * 10, {"crf": "12"}), folder / "cam_01.png"]


@pytest.fixture
def page(served: Served) -> Iterator[Page]:
    with opened(f"{served.client.base_url}#/calibrations", allowed=("422 (Unprocessable",)) as page:
        page.get_by_label("From").select_option("scene")
        page.get_by_role("link", name="Mark the points").click()
        yield page


def look(page: Page, name: str) -> None:
    if LOOK:
        page.screenshot(path=f"{LOOK}/{name}.png", full_page=True)


def click(page: Page, camera: Camera, pixel: np.ndarray) -> None:
    still = page.get_by_role("application")
    box = still.bounding_box()
    assert box is not None
    share = (pixel + 0.5) / np.array(camera.size_px)
    still.click(position={"x": float(share[0] * box["width"]), "y": float(share[1] * box["height"])})


def tab(page: Page, camera: str) -> Locator:
    return page.get_by_role("button", name=f"{camera}:")


def test_clicked_points_calibrate_cameras(page: Page, served: Served, files: list[Path]) -> None:
    page.get_by_label("Videos or pictures").set_input_files(files)
    page.get_by_label("Points in metres").fill(TABLE)
    expect(page.get_by_text("Points read: 8. Z points up")).to_be_visible()
    for camera in CAMERAS:
        tab(page, camera.name).click()
        for pixel in pixels(camera):
            click(page, camera, pixel)
        expect(tab(page, camera.name)).to_have_text(f"{camera.name}: 8 of 8")
    # The last mark is moved by the keys: 30 pixels to the right are a wrong point.
    for _ in range(3):
        page.get_by_role("application").press("Shift+ArrowRight")
    look(page, "marked")
    page.get_by_label("Name", exact=True).fill("Hall")
    page.get_by_role("button", name="Calibrate").click()
    alert = page.get_by_role("alert")
    expect(alert).to_contain_text("The point P7 is 30 px off; without it the error is", timeout=WAIT_MS)
    expect(alert).to_contain_text("cam_01")
    look(page, "refused")
    page.get_by_role("button", name="Undo").click()
    page.get_by_role("button", name="Calibrate").click()
    expect(page.get_by_role("heading", name="Stored: Hall")).to_be_visible(timeout=WAIT_MS)
    expect(alert).to_be_hidden()
    expect(page.get_by_role("list", name="Points").get_by_role("listitem").first).to_contain_text("px off")
    look(page, "stored")
    assert axe_findings(page) == []
    (stored,) = [
        each
        for each in served.client.get("/v1/calibrations").json()["calibrations"]
        if each["name"] == "Hall" and each["method"] == "scene"
    ]
    for camera, truth in zip(stored["cameras"], CAMERAS, strict=True):
        np.testing.assert_allclose(camera["position_m"], center_in_world(truth), atol=0.2)
    assert max(camera["reprojection_error_px"] for camera in stored["report"]["cameras"]) < 2.0

    # Calibrating again, with lenses of a stored calibration, replaces the calibration.
    page.get_by_role("link", name="Calibrations", exact=True).click()
    page.go_back()
    page.get_by_label("Lens values").select_option(stored["id"])
    page.get_by_label("Name", exact=True).fill("Hall again")
    page.get_by_role("button", name="Calibrate").click()
    expect(page.get_by_role("heading", name="Stored: Hall again")).to_be_visible(timeout=WAIT_MS)
    names = [each["name"] for each in served.client.get("/v1/calibrations").json()["calibrations"]]
    assert "Hall" not in names
    again = served.client.get("/v1/calibrations").json()["calibrations"][names.index("Hall again")]
    assert again["cameras"][0]["matrix"] == stored["cameras"][0]["matrix"]


def test_marks_are_set_by_keys_alone_and_kept(page: Page, files: list[Path]) -> None:
    page.get_by_label("Videos or pictures").set_input_files(files[1])
    page.get_by_label("Points in metres").fill("a, 0, 0, 0\nb, 1, 0\nc, 0, 1, 0")
    expect(page.get_by_text("Can't be read: line 2.")).to_be_visible()
    page.get_by_label("Points in metres").fill("a, 0, 0, 0\nb, 1, 0, 0\nc, 0, 1, 0")
    still, points = page.get_by_role("application"), page.get_by_role("list", name="Points").get_by_role("listitem")
    expect(page.get_by_text("Click a in the picture")).to_be_visible()
    still.press("Enter")
    still.press("ArrowLeft")
    still.press("Shift+ArrowDown")
    expect(points.nth(0)).to_contain_text("639.0, 370.0 px")
    still.press("Enter")
    expect(points.nth(1)).to_contain_text("639.0, 370.0 px")
    still.press("Delete")
    expect(points.nth(1)).to_contain_text("no mark")
    still.press("Control+z")
    still.press("Control+z")
    still.press("Control+z")
    expect(points.nth(0)).to_contain_text("640.0, 360.0 px")
    with page.expect_download() as saved:
        page.get_by_role("button", name="Save the marks").click()
    assert saved.value.suggested_filename == "points.csv"
    assert saved.value.path().read_text() == "name,x_m,y_m,z_m,camera,x_px,y_px\na,0,0,0,cam_01,640,360\n"
    # The marks stay while another view is open; a saved table has them, too.
    page.get_by_role("link", name="Calibrations", exact=True).click()
    page.go_back()
    expect(points.nth(0)).to_contain_text("640.0, 360.0 px")
    page.get_by_label("Points in metres").fill("name,x_m,y_m,z_m,camera,x_px,y_px\nd,0,0,1,cam_01,5.5,7")
    expect(points.nth(0)).to_contain_text("5.5, 7.0 px")
    # A mark of the table that was moved stays where it is.
    points.nth(0).get_by_role("button").click()
    still.press("ArrowRight")
    page.get_by_role("link", name="Calibrations", exact=True).click()
    page.go_back()
    expect(points.nth(0)).to_contain_text("6.5, 7.0 px")
    page.set_viewport_size(PHONE)
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    look(page, "phone")


def test_file_that_browser_cannot_show_is_named(page: Page, tmp_path: Path) -> None:
    (tmp_path / "cam_02.mp4").write_bytes(b"no video")
    page.get_by_label("Videos or pictures").set_input_files(tmp_path / "cam_02.mp4")
    expect(page.get_by_role("alert")).to_contain_text("can't show cam_02.mp4")


def test_calibration_is_downloaded_in_formats_and_rig_is_planned(served: Served) -> None:
    content = encode(CAMERAS)
    served.client.post("/v1/calibrations", files=[("calibration", ("planned.json", content))]).raise_for_status()
    with opened(f"{served.client.base_url}#/calibrations") as page:
        page.get_by_label("Format of planned.json").select_option("Qualisys QCA")
        with page.expect_download(timeout=WAIT_MS) as download:
            page.get_by_role("button", name="Download planned.json").click()
        assert download.value.suggested_filename == "planned.json.qca.txt"
        assert "<calibration" in download.value.path().read_text()
        page.get_by_role("link", name="Plan a rig").click()
        plan = page.get_by_role("form", name="Plan of a rig")
        plan.get_by_label("People").fill("3")
        plan.get_by_role("button", name="Plan").click()
        result = page.get_by_role("region", name="Result")
        expect(result).to_contain_text("of the floor is covered", timeout=WAIT_MS)
        assert result.get_by_role("row").count() == 10
        picture = result.get_by_role("img")
        assert picture.evaluate("(image) => image.decode().then(() => image.naturalWidth)") > 0
        look(page, "plan")
        assert axe_findings(page) == []
        plan.get_by_role("combobox").select_option(index=1)
        expect(plan.get_by_label("Field of view")).to_be_disabled()
        page.set_viewport_size(PHONE)
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
