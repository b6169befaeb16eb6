"""A tenant with chunks of minutes does not delay the jobs of other tenants."""

import contextlib
import itertools
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import httpx2
import numpy as np

from pipeline.calibration.write import encode
from pipeline.capture.keypoint_files.people import MAX_PEOPLE
from pipeline.core.data.detections import Detections
from pipeline.run.engine.stage import LENGTHS
from tests.e2e.serving import Served, serving
from tests.hostile.crowds import hostile_crowds
from tests.hostile.keypoints import archive, keypoint_files, simulate
from tests.waiting import wait_for
from worker.store.model.rights import Scope
from worker.store.store import JobStore

NUM_CAMERAS, NUM_FRAMES, RATE_HZ = 4, 20, 5
FINISHED = {"succeeded", "failed", "canceled"}


def crowd_files() -> dict[str, bytes]:
    """Session of a crowd whose people look alike: clustering takes minutes to measure their bones, in one chunk."""
    session = hostile_crowds(MAX_PEOPLE, NUM_CAMERAS, NUM_FRAMES)["nearly in one place"]()
    names = [camera.name for camera in session.cameras]
    rows = [f"{name},{frame},{frame / RATE_HZ}" for name in names for frame in range(NUM_FRAMES)]
    return {
        "calibration.json": encode(session.cameras),
        "timestamps.csv": "\n".join(["camera,frame,time_s", *rows]).encode(),
    } | {f"{name}.zip": archive(dict(_frames(session.detections[name]))) for name in names}


def _frames(detections: Detections) -> Iterator[tuple[str, bytes]]:
    people = np.concatenate([detections.keypoints_px.round(1), detections.score[..., None]], axis=-1)
    for frame, (first, last) in enumerate(itertools.pairwise(range(0, len(people) + 1, MAX_PEOPLE))):
        found = [{"pose_keypoints_2d": one.ravel().tolist()} for one in people[first:last]]
        yield f"frame_{frame:012d}_keypoints.json", json.dumps({"people": found}).encode()


def form(files: Mapping[str, bytes], spec: Mapping[str, Any]) -> list[Any]:
    kinds = {".zip": "keypoints", ".csv": "timestamps", ".json": "calibration"}
    parts = [(kinds[Path(name).suffix], (name, content)) for name, content in files.items()]
    return [*parts, ("manifest", (None, json.dumps({"layout": "coco-17"}))), ("spec", (None, json.dumps(spec)))]


@contextlib.contextmanager
def client_of(served: Served, secret: str) -> Iterator[httpx2.Client]:
    headers = {"Authorization": f"Bearer {secret}"}
    with httpx2.Client(base_url=served.client.base_url, headers=headers, timeout=120.0, trust_env=False) as client:
        yield client


def job_of(client: httpx2.Client, job_id: str) -> dict[str, Any]:
    return dict(client.get(f"/v1/jobs/{job_id}").raise_for_status().json())


def state_of(job: Mapping[str, Any], stage: str) -> str:
    (found,) = [known["state"] for known in job["stages"] if known["name"] == stage]
    return str(found)


def test_long_chunks_of_one_tenant_delay_no_other(tmp_path: Path) -> None:
    store = JobStore(f"sqlite:///{tmp_path / 'multicap.db'}")
    store.migrate()
    secrets = [store.keys.add(name, name, {Scope.READ, Scope.WRITE}, None)[1] for name in ("hostile", "ordinary")]
    store.close()
    with (
        serving(tmp_path) as served,
        client_of(served, secrets[0]) as hostile,
        client_of(served, secrets[1]) as ordinary,
    ):
        crowd = form(crowd_files(), {"method": "clustering", "force": True})
        long = [hostile.post("/v1/jobs", files=crowd).raise_for_status().json()["id"] for _ in range(2)]
        wait_for(lambda: state_of(job_of(hostile, long[0]), LENGTHS) == "running")
        files = form(keypoint_files(simulate(num_views=3)), {})
        short = ordinary.post("/v1/jobs", files=files).raise_for_status().json()["id"]
        wait_for(lambda: job_of(ordinary, short)["state"] in FINISHED)
        assert job_of(ordinary, short)["state"] == "succeeded"
        for job_id in long:
            job = job_of(hostile, job_id)
            assert job["state"] in {"queued", "running"}
            assert state_of(job, LENGTHS) != "done"
            hostile.post(f"/v1/jobs/{job_id}/cancel").raise_for_status()
        wait_for(lambda: all(job_of(hostile, job_id)["state"] == "canceled" for job_id in long), timeout_s=180.0)
