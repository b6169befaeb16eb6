"""Stored files that are damaged while the service runs: no job and no download uses them."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx2
import pytest

from pipeline.run.engine.stage import DESCRIPTION, MOTION
from tests.e2e.captures import keypoint_capture, video_capture
from tests.e2e.serving import Served, serving
from tests.e2e.test_serve_keypoints import files
from tests.waiting import wait_for
from tests.worker.store.damage import damage_under, overwrite

ENVIRONMENT = {"MULTICAP_LEASE_S": "3", "MULTICAP_HEARTBEAT_S": "0.5", "MULTICAP_REAP_INTERVAL_S": "1"}

Parts = list[tuple[str, tuple[str, bytes]]]


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    with serving(tmp_path_factory.mktemp("served") / "data", **ENVIRONMENT) as served:
        yield served


@pytest.fixture(scope="module")
def keypoints(tmp_path_factory: pytest.TempPathFactory) -> Parts:
    folder = tmp_path_factory.mktemp("keypoints")
    keypoint_capture(folder)
    return files(folder)


@pytest.fixture(scope="module")
def videos(tmp_path_factory: pytest.TempPathFactory) -> Parts:
    folder = tmp_path_factory.mktemp("videos")
    video_capture(folder)
    sent = [("videos", (path.name, path.read_bytes())) for path in sorted((folder / "videos").iterdir())]
    return [*sent, ("calibration", ("calibration.json", (folder / "calibration.json").read_bytes()))]


def flip(path: Path) -> None:
    """Change forty bytes in the middle, in place."""
    middle = path.stat().st_size // 2
    content = path.read_bytes()[middle : middle + 40]
    overwrite(path, middle, bytes(byte ^ 255 for byte in content))


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-1])


def remove(path: Path) -> None:
    path.unlink()


def stored(served: Served, pattern: str) -> list[Path]:
    return sorted((served.data_dir / "artifacts").glob(pattern))


def reconstruct(served: Served, session_id: str, **spec: Any) -> dict[str, Any]:
    job = served.client.post(f"/v1/sessions/{session_id}/jobs", json=spec).raise_for_status().json()
    return served.wait_for_end(job["id"])


@pytest.mark.parametrize(
    ("damage", "name", "pattern"),
    [
        (flip, "left.mp4", "inputs/*left.mp4"),
        (truncate, "The record", "record"),
        (remove, "left.mp4", "inputs/*left.mp4"),
    ],
)
def test_damaged_input_ends_job_with_its_name(
    served: Served, videos: Parts, name: str, pattern: str, damage: Callable[[Path], None]
) -> None:
    session = served.client.post("/v1/sessions", files=videos).raise_for_status().json()
    (path,) = stored(served, f"sessions/{session['id']}/{pattern}")
    content = path.read_bytes()
    damage(path)
    job = reconstruct(served, session["id"])
    assert job["state"] == "failed"
    assert job["error"]["code"] == "input_damaged"
    assert job["error"]["detail"].startswith(name)
    assert job["error"]["hint"].startswith("Send the capture again.")
    assert not job["error"]["retryable"]
    assert job["urls"]["retry"] is None
    (attempt,) = served.client.get(job["urls"]["attempts"]).json()["attempts"]
    assert len(attempt["failures"]) == 1
    # An operator with a copy can restore the file.
    path.write_bytes(content)
    retried = served.client.post(f"/v1/jobs/{job['id']}/retry").raise_for_status().json()
    assert served.wait_for_end(retried["id"])["state"] == "succeeded"


def test_every_stored_file_of_finished_job_may_be_damaged(served: Served, keypoints: Parts) -> None:
    session = served.client.post("/v1/sessions", files=keypoints).raise_for_status().json()
    job = reconstruct(served, session["id"])
    before = served.downloads(job["id"])
    for number, path in enumerate(stored(served, f"sessions/{session['id']}/stages/*")):
        (flip, truncate, remove)[number % 3](path)
    results = stored(served, f"jobs/{job['id']}/results/*/*")
    for path in results:
        flip(path)
    for path in results:
        answer = served.client.get(f"/v1/jobs/{job['id']}/results/{path.name}")
        assert (answer.status_code, answer.json()["code"]) == (500, "result_damaged")
    answer = served.client.get(f"/v1/jobs/{job['id']}/results.zip")
    # The files for viewers are not part of the archive.
    of_archive = [path.name for path in results if path.name not in {MOTION, DESCRIPTION}]
    assert [item["file"] for item in answer.json()["errors"]] == of_archive
    again = reconstruct(served, session["id"])
    assert served.downloads(again["id"]) == before
    assert not any(stage["reused"] for stage in again["stages"])


def test_database_that_is_damaged_under_running_service(tmp_path: Path, keypoints: Parts) -> None:
    with serving(tmp_path / "data", 1, **ENVIRONMENT) as served:
        job = served.client.post("/v1/jobs", files=keypoints).raise_for_status().json()
        assert served.wait_for_end(job["id"])["state"] == "succeeded"
        database = served.data_dir / "multicap.db"
        damage_under(database)

        def codes(answer: httpx2.Response) -> set[str]:
            return {answer.json()["code"], *(item["code"] for item in answer.json()["errors"])}

        wait_for(lambda: served.client.get(f"/v1/jobs/{job['id']}").status_code == 503)
        assert codes(served.client.post("/v1/jobs", files=keypoints)) == {"database_damaged"}
        assert "database_damaged" in codes(served.client.get("/readyz"))
        reaper = served.data_dir / "logs" / "reaper.log"
        wait_for(lambda: reaper.exists() and f"error: The database {database} is damaged" in reaper.read_text())
        logs = "".join(path.read_text() for path in (served.data_dir / "logs").glob("*.log"))
    assert "multicap backup restore" in logs
    traces = [line for line in logs.splitlines() if line.startswith("{") and "exception" in json.loads(line)]
    assert traces == []
    assert "Traceback" not in logs
