"""Time from a correction to all files of the sample, and to files in another format.

Run it by ``pytest -s -m benchmark tests/e2e/test_correction_speed.py`` on a machine that does nothing else.
"""

import statistics
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from pipeline.core.runtime.packages.samples import Sample
from tests.e2e.serving import Served, serving

pytestmark = pytest.mark.benchmark

NUM_TIMES = 3


def edits_of(content: dict[str, Any], number: int) -> dict[str, dict[str, Any]]:
    """Edits of the sample's first person in the middle of the take, other ones for each number."""
    track, names = content["tracks"][0], content["joint_names"]
    row = len(track["positions_m"]) // 2
    frame, (x, y, z) = track["start_frame"] + row, track["positions_m"][row][names.index("right_elbow")]
    person = {"frame": frame, "place_m": track["positions_m"][row][names.index("left_hip")]}
    spans = {"start_frame": frame, "stop_frame": frame + 3 + number}
    return {
        "key": {"joint": "right_elbow", "frame": frame, "place_m": [x, y, z + 0.03 * (number + 1)], "person": person},
        "exchange_sides": {"part": "legs", "person": person, **spans},
        "rename": {"name": f"Ada {number}", "person": person},
    }


def timed_s(served: Served, job: str, act: Callable[[], Any]) -> float:
    started = time.monotonic()
    act()
    while (state := served.job(job)["files_state"]) != "current":
        assert state == "updating"
        time.sleep(0.02)
    return time.monotonic() - started


def test_corrections_and_formats_reach_the_files(tmp_path: Path, sample: Sample) -> None:
    with serving(tmp_path / "data") as served:
        job = served.wait_for_end(served.post(sample, exports=["bvh"]))["id"]
        content = served.client.get(f"/v1/jobs/{job}/results/skeletons.json").raise_for_status().json()
        times_s: dict[str, list[float]] = {}
        for number in range(NUM_TIMES):
            for action, fields in edits_of(content, number).items():
                act = partial(served.edit, job, {"action": action, **fields})
                times_s.setdefault(action, []).append(timed_s(served, job, act))
            more = {"exports": [("fbx", "glb", "c3d")[number]]}
            times_s.setdefault("format", []).append(
                timed_s(served, job, partial(served.client.post, f"/v1/jobs/{job}/files", json=more))
            )
    print({action: [round(one_s, 2) for one_s in found] for action, found in times_s.items()})  # noqa: T201 - a result
    assert max(map(statistics.median, times_s.values())) <= 3.0
