"""Time from a correction to the picture of the page, to all files of the sample, and to files in another format.

Run it by ``pytest -s -m benchmark tests/e2e/test_correction_speed.py`` on a machine that does nothing else.
"""

import statistics
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.core.runtime.packages.samples import Sample
from tests.e2e.serving import Served, serving
from tests.e2e.test_joint_tool import drag, edits, job_ids, live, place_of, shown
from tests.e2e.viewer_pages import Shown

__all__ = ["job_ids", "live", "shown"]

pytestmark = pytest.mark.benchmark

NUM_TIMES = 3

# Notes when a pointer is released, and when the second picture after it is drawn: then the first one is on the screen.
WATCH = """() => {
  globalThis.delaysMs = [];
  document.addEventListener("pointerup", () => {
    const start = performance.now();
    const drawn = () => globalThis.delaysMs.push(performance.now() - start);
    requestAnimationFrame(() => requestAnimationFrame(drawn));
  }, true);
}"""


def test_dragged_joint_is_shown_where_it_was_let_go(shown: Shown) -> None:
    page = shown.page
    page.evaluate(WATCH)
    for number in range(10):
        drag(page, place_of(page, "right_wrist", 2)["scene"], (12, -8) if number % 2 else (-12, 8))
        np.testing.assert_allclose(place_of(page, "right_wrist", 2)["place"], edits(page)[-1]["place_m"], atol=1e-5)
    page.wait_for_function("() => globalThis.delaysMs.length === 10")
    delays_ms = page.evaluate("globalThis.delaysMs")
    print([round(delay_ms) for delay_ms in delays_ms], "ms")  # noqa: T201 - a benchmark's result
    assert max(delays_ms) <= 200


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
