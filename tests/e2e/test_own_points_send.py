"""File about own points in the page's form: it is told from calibrations by its content, and sent beside keypoints."""

import io
import json
import zipfile
from pathlib import Path

import pytest
from playwright.sync_api import expect

from tests.api.web.sessions.test_own_points_sessions import OBJECTS, own_files
from tests.e2e.browsing import axe_findings, opened
from tests.e2e.serving import Served
from tests.pipeline.media import write_video
from tests.pipeline.own_point_scenes import rigid_scene

pytestmark = pytest.mark.xdist_group("page")


def write_capture(folder: Path) -> list[Path]:
    """Zips of keypoints, timestamps, calibration, and a file about own points."""
    written = {"own.json": json.dumps(OBJECTS).encode()}
    for path, content in own_files(rigid_scene(duration_s=0.6, num_views=3)).items():
        if not path.startswith("keypoints/"):
            written[path] = content
            continue
        archive = io.BytesIO()
        with zipfile.ZipFile(archive, "w") as file:
            file.writestr("annotations.json", content)
        written[f"{path.split('/')[1]}.zip"] = archive.getvalue()
    for name, content in written.items():
        (folder / name).write_bytes(content)
    return [folder / name for name in written]


def test_file_about_own_points_is_sent_beside_keypoints(served: Served, tmp_path: Path) -> None:
    files = write_capture(tmp_path)
    with opened(f"{served.client.base_url}#/new") as page:
        page.get_by_label("Name of the capture").fill("Racket and box")
        page.get_by_label("Choose files").set_input_files(files)
        expect(page.get_by_text("objects, bones")).to_be_visible()
        (tmp_path / "second.yaml").write_text("objects:\n  box: {}\n")
        video = write_video(tmp_path / "door.mp4", 5)
        page.get_by_label("Choose files").set_input_files([tmp_path / "second.yaml", video])
        page.get_by_role("button", name="Send and reconstruct").click()
        expect(page.get_by_text("A capture has one file about points of your own")).to_be_visible()
        expect(page.get_by_text("Files about keypoints can't be sent with videos.")).to_be_visible()
        page.get_by_role("checkbox", name="second.yaml").uncheck()
        page.get_by_role("checkbox", name=video.name).uncheck()
        assert axe_findings(page) == []
        with page.expect_response("**/v1/sessions", timeout=120_000) as answered:
            page.get_by_role("button", name="Send and reconstruct").click()
        assert answered.value.status == 201, answered.value.text()
        assert json.loads(answered.value.request.post_data or "{}")["own_points"]
        findings = answered.value.json()["preflight"]["findings"]
        assert any(finding["message"].startswith("own.json has racket of tip") for finding in findings)
