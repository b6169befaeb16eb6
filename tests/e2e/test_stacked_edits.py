"""Edits of people that follow each other quickly while workers are killed: files of the last list, byte for byte."""

import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

from pipeline.validation.simulation.scenes import find_scene, record
from tests.e2e.serving import Served, serving
from tests.e2e.test_serve_keypoints import files
from tests.pipeline.simulations import write_simulation
from tests.waiting import wait_for

NUM_LISTS, SEED = 12, 35


@pytest.fixture
def service(tmp_path: Path) -> Iterator[Served]:
    short = {"MULTICAP_LEASE_S": "3", "MULTICAP_HEARTBEAT_S": "0.3", "MULTICAP_REAP_INTERVAL_S": "0.5"}
    with serving(tmp_path / "data", **short) as running:
        yield running


def reconstructed(served: Served, capture: Path) -> str:
    """A job of a session of its own, so that it finds no pieces of another job."""
    answer = served.client.post("/v1/jobs", files=files(capture), timeout=120)
    assert answer.status_code == 202, answer.text
    assert served.wait_for_end(answer.json()["id"])["state"] == "succeeded"
    return str(answer.json()["id"])


def lists_of_edits(found: list[dict[str, int]], rng: np.random.Generator) -> list[list[dict[str, Any]]]:
    """Lists as somebody sends them who tries things out, and undoes some of them."""
    one, other = (person["id"] for person in sorted(found, key=lambda person: -person["num_frames"])[:2])
    middle = max(person["start_frame"] + person["num_frames"] // 2 for person in found if person["id"] in (one, other))
    edits: list[dict[str, Any]] = [
        {"action": "rename", "person": one, "name": "Anna"},
        {"action": "exchange", "person": one, "other": other, "start_frame": middle},
        {"action": "cut", "start_frame": 5, "stop_frame": middle + 5},
        {"action": "rename", "person": other, "name": "Eve"},
    ]
    lists = [[edit for edit in edits if rng.random() < 0.6] for _ in range(NUM_LISTS - 1)]
    return [*lists, edits]


@pytest.mark.slow
def test_last_of_stacked_edits_wins_while_workers_are_killed(service: Served, tmp_path: Path) -> None:
    write_simulation(record(replace(find_scene("room"), duration_s=6.0), seed=4, num_views=3), tmp_path / "capture")
    job_id, quiet_id = (reconstructed(service, tmp_path / "capture") for _ in range(2))
    lists = lists_of_edits(service.edits(job_id)["run"]["found"], np.random.default_rng(SEED))
    service.edit(quiet_id, *lists[-1])
    assert service.wait_for_end(quiet_id)["files_state"] == "current"
    expected = service.downloads(quiet_id)

    rng, names = np.random.default_rng(SEED), set(service.downloads(job_id))
    killed = 0
    for number, edits in enumerate(lists, start=1):
        answer = service.edit(job_id, *edits)
        assert answer["revision"] == number
        if number % 3 == 0:
            killed += kill_a_worker(service)
        time.sleep(rng.uniform(0, 0.6))
        require_whole(service, job_id)
    wait_for(lambda: service.job(job_id)["results_revision"] == NUM_LISTS, timeout_s=240)
    assert killed >= 3
    assert service.job(job_id)["files_state"] == "current"
    assert service.downloads(job_id) == expected
    service.edit(job_id)
    assert service.wait_for_end(job_id)["files_state"] == "current"
    assert set(service.downloads(job_id)) == names


def kill_a_worker(served: Served) -> int:
    """Kill a process that runs chunks; returns how many were killed."""
    children = served.part("worker").children()
    try:
        children[-1].kill()
    except (psutil.NoSuchProcess, IndexError):
        return 0
    return 1


def require_whole(served: Served, job_id: str) -> None:
    """Files of one revision can be read at any time."""
    listed = served.client.get(f"/v1/jobs/{job_id}/results").raise_for_status().json()["results"]
    assert {"skeletons.json", "metrics.json"} < {one["name"] for one in listed}
    assert len({one["revision"] for one in listed}) == 1
    assert served.client.get(f"/v1/jobs/{job_id}/results.zip").status_code == 200
    assert served.client.get(f"/v1/jobs/{job_id}/motion/description").status_code == 200
