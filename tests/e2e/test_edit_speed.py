"""Time from an edit of people to its files, in the real service: the sample, and 10 people of 10,000 frames."""

import time
import zipfile
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import Any

import pytest

from pipeline.core.runtime.packages.samples import Sample
from pipeline.validation.simulation.motion.director import Cast
from pipeline.validation.simulation.rigs import Clock, Layout, Rig
from pipeline.validation.simulation.scenes import Scene, record, simulation_files
from tests.e2e.serving import Served, is_at_rest, serving
from tests.waiting import wait_for

pytestmark = pytest.mark.benchmark

NUM_FRAMES, RATE_HZ = 10_000, 25.0
STAGE = Scene(
    Rig(Layout.RING, 4, (7.0, 6.0), 2.8, (1920, 1080), 1000.0),
    Cast(10, (8.0, 6.0), walking=0.5),
    Clock(RATE_HZ),
    duration_s=NUM_FRAMES / RATE_HZ,
)


@pytest.fixture
def service(tmp_path: Path) -> Iterator[Served]:
    with serving(tmp_path / "data", MULTICAP_PREFLIGHT_TIMEOUT_S="1800") as running:
        yield running


def edited(served: Served, job_id: str, *edits: dict[str, Any]) -> float:
    """Replace the edits of a job; seconds from the request to the list of the new files."""
    start_s = time.monotonic()
    served.edit(job_id, *edits)
    while not is_at_rest(job := served.job(job_id)):
        time.sleep(0.05)
    assert job["files_state"] == "current", job["error"]
    assert served.client.get(f"/v1/jobs/{job_id}/results").raise_for_status().json()["results"]
    return time.monotonic() - start_s


def measured(served: Served, job_id: str) -> dict[str, float]:
    """Seconds of each kind of edit of a job with two people at least; the edits add up."""
    people = served.edits(job_id)["run"]
    one, other = sorted(people["found"], key=lambda person: -person["num_frames"])[:2]
    middle = max(one["start_frame"], other["start_frame"]) + min(one["num_frames"], other["num_frames"]) // 2
    pair = {"person": one["id"], "other": other["id"]}
    edits = [
        {"action": "rename", "person": one["id"], "name": "Anna"},
        {"action": "exchange", **pair, "start_frame": middle},
        {"action": "split", "person": one["id"], "frame": middle},
        {"action": "cut", "start_frame": 10, "stop_frame": people["num_frames"] - 10},
        {"action": "merge", **pair},
    ]
    seconds = {
        f"{number + 1} edits, the last one {edits[number]['action']}": edited(served, job_id, *edits[: number + 1])
        for number in range(len(edits))
    }
    return seconds | {"all undone": edited(served, job_id)}


def finished(served: Served, job_id: str, timeout_s: float) -> None:
    wait_for(lambda: served.job(job_id)["state"] in {"succeeded", "failed"}, timeout_s=timeout_s)
    assert served.job(job_id)["state"] == "succeeded", served.job(job_id)["error"]


def crowd(folder: Path) -> list[tuple[str, tuple[str, bytes]]]:
    """Parts of a session of keypoints of ten people who walk about for 10,000 frames."""
    archives: dict[str, zipfile.ZipFile] = {}
    parts = []
    for name, content in simulation_files(record(STAGE, 0, STAGE.rig.num_cameras)):
        path = PurePosixPath(name)
        if path.parts[0] == "keypoints":
            camera = path.parts[1]
            if camera not in archives:
                archives[camera] = zipfile.ZipFile(folder / f"{camera}.zip", "w", zipfile.ZIP_DEFLATED, compresslevel=1)
            archives[camera].writestr(path.name, content)
        elif path.suffix in {".json", ".csv"}:
            parts.append((path.stem, (path.name, content)))
    for camera, archive in archives.items():
        archive.close()
        parts.append(("keypoints", (f"{camera}.zip", (folder / f"{camera}.zip").read_bytes())))
    return parts


def test_edits_of_sample(service: Served, sample: Sample) -> None:
    job_id = service.post(sample)
    finished(service, job_id, 600)
    seconds = measured(service, job_id)
    print(seconds)  # noqa: T201 - a benchmark's result
    assert max(seconds.values()) <= 5


def test_edits_of_ten_people_and_ten_thousand_frames(service: Served, tmp_path: Path) -> None:
    answer = service.client.post("/v1/jobs", files=crowd(tmp_path), timeout=600)
    assert answer.status_code == 202, answer.text
    job_id = answer.json()["id"]
    finished(service, job_id, 3600)
    people = service.edits(job_id)["run"]
    assert people["num_frames"] >= NUM_FRAMES - 10
    assert sum(person["num_frames"] for person in people["found"]) >= 9.5 * NUM_FRAMES
    seconds = measured(service, job_id)
    print(seconds)  # noqa: T201 - a benchmark's result
    assert max(seconds.values()) <= 30
