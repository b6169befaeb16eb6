"""Report and overlay videos of a real job, by the workers of a real service, before and after an edit of people."""

import io
import json
import re
from collections.abc import Iterator
from contextlib import ExitStack

import av
import numpy as np
import pytest

from pipeline.core.runtime.packages.samples import Sample
from tests.e2e.serving import Served

pytestmark = [pytest.mark.xdist_group("sample"), pytest.mark.slow]

NUM_FRAMES = 25
SPEC = {"profile": "fast", "frame_range": [0, NUM_FRAMES], "report": True, "overlay": True}


def post(served: Served, sample: Sample) -> str:
    with ExitStack() as opened:
        files = [("videos", (path.name, opened.enter_context(path.open("rb")))) for path in sample.videos.values()]
        calibration = ("calibration", (sample.calibration.name, sample.calibration.read_bytes()))
        spec = ("spec", (None, json.dumps(SPEC).encode()))
        answer = served.client.post("/v1/jobs", files=[*files, calibration, spec], timeout=120)
    assert answer.status_code == 202, answer.text
    return str(answer.json()["id"])


def downloaded(served: Served, job_id: str) -> dict[str, bytes]:
    """Report and overlay videos of a job by name."""
    listed = served.client.get(f"/v1/jobs/{job_id}/results").raise_for_status().json()["results"]
    names = [one["name"] for one in listed if one["kind"] in {"report", "overlay"}]
    return {name: served.client.get(f"/v1/jobs/{job_id}/results/{name}").raise_for_status().content for name in names}


def pictures(video: bytes) -> Iterator[np.ndarray]:
    with av.open(io.BytesIO(video), "r") as opened:
        for frame in opened.decode(video=0):
            yield frame.to_ndarray(format="rgb24").astype(int)


def test_report_and_overlays_follow_edit(served: Served, sample: Sample) -> None:
    job_id = post(served, sample)
    assert served.wait_for_end(job_id)["state"] == "succeeded"
    first = downloaded(served, job_id)
    assert set(first) == {"report.html", *(f"overlay-{camera}.mp4" for camera in sample.videos)}
    # One file that loads nothing.
    report = first["report.html"].decode()
    assert not re.search(r"""(src|href)=["']?(https?:)?//""", report)
    assert all(path.name in report for path in sample.videos.values())
    assert "Anna" not in report

    people = served.edits(job_id)["run"]["found"]
    longest = max(people, key=lambda person: person["num_frames"])
    rename = {"action": "rename", "person": longest["id"], "name": "Anna"}
    served.edit(job_id, rename)
    job = served.wait_for_end(job_id)
    assert (job["state"], job["results_revision"]) == ("succeeded", 1)
    assert not {"draw_overlay", "write_report"} & {stage["name"] for stage in job["stages"]}
    assert downloaded(served, job_id) == first
    visuals = served.client.post(job["urls"]["visuals"]).raise_for_status().json()
    assert served.wait_for_end(visuals["id"])["state"] == "succeeded"
    second = downloaded(served, job_id)
    assert set(second) == set(first)
    assert "Anna" in second["report.html"].decode()
    for name in set(first) - {"report.html"}:
        before, after = list(pictures(first[name])), list(pictures(second[name]))
        assert len(before) == len(after) == NUM_FRAMES
        # The label alone changed: some pixels of the pictures, not most.
        shares = [(np.abs(one - other).max(-1) > 60).mean() for one, other in zip(before, after, strict=True)]
        assert 0 < max(shares) < 0.05
