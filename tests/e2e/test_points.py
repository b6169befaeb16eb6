"""3D points of another system in a running service: the page's form, the job with its viewer, and the client."""

import json
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import expect

from api.cli.client import Client
from pipeline.capture.points import open_points
from tests.e2e.browsing import axe_findings, opened
from tests.e2e.points import write_walk
from tests.e2e.serving import Served

pytestmark = pytest.mark.xdist_group("page")


def test_points_go_from_form_to_viewer(served: Served, tmp_path: Path) -> None:
    paths = write_walk(tmp_path)
    with opened(f"{served.client.base_url}#/new") as page:
        page.get_by_label("Name of the capture").fill("Walkers")
        page.get_by_label("Choose files").set_input_files(paths)
        expect(page.get_by_label("Frame rate of the points, Hz")).to_be_visible()
        expect(page.get_by_role("heading", name="Calibration")).to_have_count(0)
        expect(page.get_by_label("Layout of keypoints")).to_have_count(0)
        page.get_by_text("Customise", exact=True).click()
        expect(page.get_by_label("Smoothing", exact=True)).to_have_count(1)
        expect(page.get_by_label("Detector", exact=True)).to_have_count(0)
        assert axe_findings(page) == []
        page.get_by_role("button", name="Send and reconstruct").click()
        expect(page.get_by_role("heading", name="Walkers", level=1)).to_be_visible(timeout=180_000)
        expect(page.get_by_text("Done", exact=True)).to_be_visible(timeout=240_000)
        expect(page.locator("canvas").first).to_be_visible()
        expect(page.get_by_role("region", name="Files")).to_contain_text("person-2.bvh")
        assert axe_findings(page) == []


def test_client_sends_points_and_gets_their_positions(served: Served, tmp_path: Path) -> None:
    paths = write_walk(tmp_path)
    with Client.connect(str(served.client.base_url)) as client:
        job = client.submit_points("Walk", paths, {"exports": ["csv"], "report": True}, {"frame_rate_hz": 25.0})
        assert client.get(f"/v1/jobs/{job['id']}/motion/first-people") == {"ranges": [], "next": 0}
        job = client.follow(job, timeout_s=400)
        files = {path.name: path for path in client.download(job, tmp_path / "results")}
    assert {"skeletons.json", "person-1.csv", "person-2.csv", "report.html"} <= files.keys()
    assert not [warning for warning in job["warnings"] if warning["severity"] != "info"]
    session, content = open_points(paths), json.loads(files["skeletons.json"].read_text())
    knee = content["joint_names"].index("left_knee")
    for person, track in zip(session.people, content["tracks"], strict=True):
        found_m = np.array([frame[knee] or [np.nan] * 3 for frame in track["positions_m"]], float)
        np.testing.assert_allclose(found_m, person.xyz_m[:, session.joints.names.index("left_knee")], atol=1e-3)
