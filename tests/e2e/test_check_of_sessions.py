"""Faults of a capture, through the service: found and named in the session or in its job, and shown on the page."""

import subprocess
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest

from pipeline.calibration.registry import read_calibration
from pipeline.calibration.write import encode
from pipeline.core.data.cameras import Camera
from pipeline.core.data.rigid import Rigid3
from pipeline.core.runtime.packages.samples import Sample
from tests.e2e.browsing import opened
from tests.e2e.captures import video_capture
from tests.e2e.serving import Served, serving

# Frames enough for an error, which needs some instants apart.
SPEC = {"profile": "fast", "frame_range": [0, 40], "exports": ["bvh"]}


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """Service that has time for all pictures, also on a busy machine."""
    with serving(tmp_path_factory.mktemp("data"), 1) as running:
        yield running


@dataclass(frozen=True)
class CalibratedVideos:
    """Videos by camera, and calibrated cameras."""

    videos: Mapping[str, Path]
    cameras: tuple[Camera, ...]

    def send(self, served: Served) -> dict[str, Any]:
        """Send the capture as a session; return the session."""
        with ExitStack() as files:
            videos = [
                ("videos", (f"{name}.mp4", files.enter_context(path.open("rb")))) for name, path in self.videos.items()
            ]
            calibration = ("calibration", ("calibration.json", encode(self.cameras)))
            answer = served.client.post("/v1/sessions", files=[*videos, calibration])
        assert answer.status_code == 201, answer.text
        session: dict[str, Any] = answer.json()
        return session

    def run(self, served: Served, **choices: Any) -> dict[str, Any]:
        """Send the capture and reconstruct it; return the job at its end."""
        job = served.client.post(self.send(served)["urls"]["jobs"], json=SPEC | choices).raise_for_status().json()
        return served.wait_for_end(job["id"])

    def reconstruct(self, served: Served, **choices: Any) -> dict[str, Any]:
        """Send the capture and reconstruct it; return the finished job."""
        ended = self.run(served, **choices)
        assert ended["state"] == "succeeded", ended["error"]
        return ended

    def refused(self, served: Served) -> tuple[dict[str, Any], dict[str, str]]:
        """Send the capture, whose reconstruction is refused; return the job, and codes of the errors by camera."""
        job = self.run(served)
        assert (job["state"], job["error"]["code"], job["error"]["stage"]) == (
            "failed",
            "session_refused",
            "check_session",
        )
        assert [stage["state"] for stage in job["stages"] if stage["name"] == "associate"] == ["canceled"]
        return job, {error["camera"]: error["code"] for error in job["error"]["errors"]}


@pytest.fixture
def capture(sample: Sample) -> CalibratedVideos:
    return CalibratedVideos(sample.videos, read_calibration(sample.calibration))


def named(findings: list[dict[str, Any]], code: str) -> dict[str, dict[str, Any]]:
    """Evidence of the findings with a code, by camera."""
    return {one["camera"]: one["evidence"] for one in findings if one["code"] == code}


def scaled(capture: CalibratedVideos, scale: float) -> CalibratedVideos:
    """Capture whose calibration is in another unit."""
    poses = [camera.cam_from_world for camera in capture.cameras]
    cameras = [
        replace(camera, cam_from_world=Rigid3(pose.rotation, scale * pose.translation_m))
        for camera, pose in zip(capture.cameras, poses, strict=True)
    ]
    return replace(capture, cameras=tuple(cameras))


def test_good_capture_has_no_error(served: Served, capture: CalibratedVideos) -> None:
    findings = capture.send(served)["preflight"]["findings"]
    assert [one for one in findings if one["severity"] != "info"] == []


def test_one_video_twice(served: Served, capture: CalibratedVideos, tmp_path: Path) -> None:
    """The second one is encoded again, smaller and at another rate."""
    copy = tmp_path / "copy.mp4"
    words = ["-i", str(capture.videos["cam01"]), "-r", "50", "-crf", "30", "-preset", "ultrafast", str(copy)]
    subprocess.run(["ffmpeg", "-v", "error", *words], check=True)
    session = replace(capture, videos={**capture.videos, "cam03": copy}).send(served)
    assert named(session["preflight"]["findings"], "same_video")["cam03"]["other_camera"] == "cam01"
    (thumbnails,) = [camera["thumbnails"] for camera in session["preflight"]["cameras"] if camera["name"] == "cam03"]
    (picture,) = named(session["preflight"]["findings"], "same_video")["cam03"]["pictures"]
    assert served.client.get(thumbnails[picture]["url"]).content.startswith(b"\xff\xd8\xff")


def test_wrong_units(served: Served, capture: CalibratedVideos) -> None:
    findings = scaled(capture, 1000.0).send(served)["preflight"]["findings"]
    assert "mm" in next(one["hint"] for one in findings if one["code"] == "world_unit")


def test_exchanged_calibrations(served: Served, capture: CalibratedVideos) -> None:
    exchange = {"cam01": "cam03", "cam03": "cam01"}
    cameras = tuple(replace(camera, name=exchange.get(camera.name, camera.name)) for camera in capture.cameras)
    job, errors = replace(capture, cameras=cameras).refused(served)
    assert errors == dict.fromkeys(exchange, "cameras_exchanged")
    with opened(f"{served.client.base_url}#/captures") as page:
        row = page.locator(f"#job-{job['id']}")
        row.wait_for()
        for error in job["error"]["errors"]:
            assert error["message"] in row.inner_text()
        row.get_by_role("button", name="anyway").click()
        page.get_by_text("Ignore errors").first.wait_for()
    jobs = served.client.get(job["urls"]["session"] + "/jobs").raise_for_status().json()["jobs"]
    (forced,) = [other for other in jobs if other["id"] != job["id"]]
    assert forced["spec"] == job["spec"] | {"force": True}
    ended = served.wait_for_end(forced["id"])
    assert ended["state"] == "succeeded", ended["error"]
    (detection,) = [stage for stage in ended["stages"] if stage["name"] == "look"]
    assert detection["reused"]
    found = named(ended["warnings"], "cameras_exchanged")
    assert {camera: evidence["other_camera"] for camera, evidence in found.items()} == exchange
    metrics = served.client.get(f"/v1/jobs/{ended['id']}/results/metrics.json").raise_for_status().json()
    assert metrics["forced"] == ["cameras_exchanged"]


def test_exchanged_videos(served: Served, capture: CalibratedVideos) -> None:
    exchange = {"cam02": "cam04", "cam04": "cam02"}
    videos = {name: capture.videos[exchange.get(name, name)] for name in capture.videos}
    _, errors = replace(capture, videos=videos).refused(served)
    assert errors == dict.fromkeys(exchange, "cameras_exchanged")


def test_rotated_camera(served: Served, capture: CalibratedVideos, tmp_path: Path) -> None:
    turned = tmp_path / "turned.mp4"
    words = ["-i", str(capture.videos["cam02"]), "-vf", "hflip,vflip", "-preset", "ultrafast", str(turned)]
    subprocess.run(["ffmpeg", "-v", "error", *words], check=True)
    job, errors = replace(capture, videos={**capture.videos, "cam02": turned}).refused(served)
    assert errors == {"cam02": "picture_turned"}
    assert "180 degrees" in job["error"]["detail"]


def test_checks_of_world_are_in_job_and_on_page(served: Served, capture: CalibratedVideos) -> None:
    job = scaled(capture, 1.6).reconstruct(served)
    metrics = served.client.get(f"/v1/jobs/{job['id']}/results/metrics.json").raise_for_status().json()
    checks = {one["code"] for one in metrics["world_checks"]}
    assert "stature_out_of_range" in checks
    assert checks <= {one["code"] for one in job["warnings"]}
    with opened(f"{served.client.base_url}#/captures") as page:
        row = page.locator(f"#job-{job['id']}")
        row.wait_for()
        assert "Done, with warnings" in row.inner_text()
        for warning in job["warnings"]:
            assert warning["message"] in row.inner_text()


def test_job_without_people_says_why(served: Served, tmp_path: Path) -> None:
    """An empty, blurred room: the findings of the pictures have thumbnails on the page."""
    video_capture(tmp_path, 40)
    cameras = read_calibration(tmp_path / "calibration.json")
    videos = {camera.name: tmp_path / "videos" / f"{camera.name}.mp4" for camera in cameras}
    # A network may find the same in both videos, which are equal.
    job = CalibratedVideos(videos, cameras).reconstruct(served, force=True)
    (nobody,) = [one for one in job["warnings"] if one["code"] == "nobody_found"]
    assert nobody["evidence"]["reason"] in {"nobody_detected", "same_video"}
    assert nobody["message"].startswith("No person was found. ")
    with opened(f"{served.client.base_url}#/captures") as page:
        row = page.locator(f"#job-{job['id']}")
        row.wait_for()
        assert "no person found" in row.inner_text()
        assert nobody["message"] in row.inner_text()
