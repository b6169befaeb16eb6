"""Edits of people in quick succession on a busy machine: no worker's process is ended, and the last edits win."""

import json
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from subprocess import Popen
from typing import Any

import pytest

from pipeline.core.runtime.parent_watch import tied_to_parent
from pipeline.validation.simulation.scenes import find_scene, record
from tests.e2e.serving import Served, serving
from tests.e2e.test_stacked_edits import reconstructed
from tests.pipeline.simulations import write_simulation

NUM_LOOPS, DURING_S = 2, 3.0


@pytest.fixture
def service(tmp_path: Path) -> Iterator[Served]:
    with serving(tmp_path / "data", MULTICAP_HEARTBEAT_S="0.1") as running:
        yield running


@pytest.fixture
def busy() -> Iterator[None]:
    """Loops that take as many processors as they get."""
    loops = [Popen(tied_to_parent([sys.executable, "-c", "while True: pass"])) for _ in range(NUM_LOOPS)]
    yield
    for loop in loops:
        loop.kill()
        loop.wait()


def lists_of_edits(found: list[dict[str, int]]) -> list[list[dict[str, Any]]]:
    """Rename, split, merge, and four undos; the last one undoes the name once more."""
    one, other = (person["id"] for person in sorted(found, key=lambda person: -person["num_frames"])[:2])
    (person,) = (person for person in found if person["id"] == one)
    rename = {"action": "rename", "person": one, "name": "Anna"}
    split = {"action": "split", "person": one, "frame": person["start_frame"] + person["num_frames"] // 2}
    merge = {"action": "merge", "person": one, "other": other}
    return [[rename], [rename, split], [rename, split, merge], [rename, split], [rename], [], [rename]]


def events(served: Served, name: str) -> list[dict[str, Any]]:
    lines = (served.data_dir / "logs" / "worker.log").read_text().splitlines()
    return [entry for line in lines if (entry := json.loads(line))["event"] == name]


@pytest.mark.slow
def test_fast_edits_end_no_worker(service: Served, busy: None, tmp_path: Path) -> None:
    write_simulation(record(replace(find_scene("room"), duration_s=6.0), seed=4, num_views=3), tmp_path / "capture")
    job_id = reconstructed(service, tmp_path / "capture")
    lists = lists_of_edits(service.edits(job_id)["run"]["found"])
    for number, edits in enumerate(lists, start=1):
        assert service.edit(job_id, *edits)["revision"] == number
        time.sleep(DURING_S / len(lists))
    job = service.wait_for_end(job_id)
    assert job["files_state"] == "current", job["error"]
    assert service.job(job_id)["results_revision"] == len(lists)
    listed = service.client.get(f"/v1/jobs/{job_id}/results").json()["results"]
    assert "Anna" in {one["person_name"] for one in listed}
    assert events(service, "chunk_stuck") == []
    assert events(service, "chunk_stopped") != [], "no edit met the files of the one before"
