"""Delay of a tenant's ``GET /v1/jobs`` while another tenant sends the costliest requests of each operation.

Run it by ``pytest -s -m benchmark tests/api/web/http/test_neighbour_speed.py``; operations that begin with
MULTICAP_OPERATIONS are measured alone.
"""

import itertools
import json
import os
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest

from pipeline.core.options.edits import MAX_EDITS
from tests.e2e.serving import serving
from tests.hostile.keypoints import keypoint_files, simulate
from tests.hostile.test_other_tenants import form
from tests.pipeline.export.character.characters import bones_of, character
from tests.waiting import wait_for
from worker.store.model.rights import Scope
from worker.store.store import JobStore

pytestmark = pytest.mark.benchmark

CONTRACT = Path(__file__).parents[4] / "openapi/openapi.json"
ONLY = os.environ.get("MULTICAP_OPERATIONS", "")
NUM_THREADS, DURATION_S, MAX_P99_S = 8, 5.0, 1.0
NUM_JOBS = 60
WIDE = {f"field_{k}": k for k in range(5_000)}
TUS = {"Tus-Resumable": "1.0.0"}


@dataclass
class Costly:
    """The costly tenant's client, and what it has made."""

    client: httpx2.Client
    files: dict[str, bytes]
    session_id: str
    job_id: str
    calibration_id: str
    character_id: str
    link_id: str
    recording_id: str

    @property
    def capture(self) -> dict[str, bytes]:
        """Files of a capture: all but the character."""
        return {name: content for name, content in self.files.items() if not name.endswith(".glb")}

    def upload(self, content: bytes) -> str:
        headers = TUS | {"Upload-Length": str(len(content)), "Upload-Metadata": "filename Y2FtLnppcA=="}
        location = self.client.post("/v1/uploads", headers=headers).raise_for_status().headers["location"]
        offset = {"Upload-Offset": "0", "Content-Type": "application/offset+octet-stream"}
        self.client.patch(location, headers=TUS | offset, content=content).raise_for_status()
        return str(location)

    def job(self) -> str:
        body = {"spec": {"exports": ["csv"]}}
        return str(self.client.post(f"/v1/sessions/{self.session_id}/jobs", json=body["spec"]).json().get("id"))

    def events(self) -> None:
        with self.client.stream("GET", f"/v1/jobs/{self.job_id}/events") as answer:
            answer.read()


def edits() -> list[dict[str, Any]]:
    """The longest list of edits, which makes many pieces of one person."""
    splits: list[dict[str, Any]] = [{"action": "split", "person": 1, "frame": frame} for frame in (3, 2)]
    names: list[dict[str, Any]] = [
        {"action": "rename", "person": 1, "name": f"{k} ".ljust(100, "n")} for k in range(400)
    ]
    return [*splits, *names][:MAX_EDITS]


def requests_of(made: Costly) -> dict[str, Callable[[], object]]:
    """The costliest requests of each operation, by its operationId, with a word behind a point for a further one."""
    client, job, session = made.client, f"/v1/jobs/{made.job_id}", f"/v1/sessions/{made.session_id}"
    link = {"scope": "job", "expires_in_s": 60}
    manifest = {"name": "x" * 50, "cameras": [{"name": f"c{k}", "file": f"c{k}.zip"} for k in range(500)]}
    calibration = json.dumps({"cameras": [{"name": "x"}] * 50_000}).encode()
    names = itertools.count()
    recording = f"/v1/recordings/{made.recording_id}"
    source = {"url": "https://127.0.0.1/cam01.mp4", "filename": "cam01.mp4"}
    hall = {"length_m": 100, "width_m": 100, "cameras": 128, "people": 100}
    return {
        "createUpload": lambda: made.upload(bytes(5_000_000)),
        "describeUploads": lambda: client.options("/v1/uploads", headers=TUS),
        "getUpload": lambda: client.head(made.upload(b"x"), headers=TUS),
        "continueUpload": lambda: made.upload(bytes(20_000_000)),
        "getUploadState": lambda: client.get(made.upload(b"x")),
        "createUploadFromUrl": lambda: client.post("/v1/uploads/from-url", json=source),
        "deleteUpload": lambda: client.delete(made.upload(bytes(1_000_000)), headers=TUS),
        "createCalibration": lambda: client.post(
            "/v1/calibrations", files={"calibration": ("c.json", made.files["calibration.json"])}
        ),
        "createCalibration.large": lambda: client.post(
            "/v1/calibrations", files={"calibration": ("c.json", calibration)}
        ),
        "createCalibration.wrong": lambda: client.post("/v1/calibrations", json=WIDE),
        "listCalibrations": lambda: client.get("/v1/calibrations", params={"limit": 100}),
        "getCalibration": lambda: client.get(f"/v1/calibrations/{made.calibration_id}"),
        "deleteCalibration": lambda: client.delete(f"/v1/calibrations/{made.session_id}"),
        "renameCalibration": lambda: client.patch(
            f"/v1/calibrations/{made.calibration_id}", json={"name": str(next(names))}
        ),
        "getCalibrationFile": lambda: client.get(
            f"/v1/calibrations/{made.calibration_id}/file", params={"format": "qca"}
        ),
        "planRig": lambda: client.get("/v1/calibrations/plan", params=hall),
        "createCharacter": lambda: client.post(
            "/v1/characters", files={"character": ("r.glb", made.files["robot.glb"])}
        ),
        "createCharacter.wrong": lambda: client.post("/v1/characters", json=WIDE),
        "listCharacters": lambda: client.get("/v1/characters", params={"limit": 100}),
        "getCharacter": lambda: client.get(f"/v1/characters/{made.character_id}"),
        "getCharacterFile": lambda: client.get(f"/v1/characters/{made.character_id}/file"),
        "changeCharacter": lambda: client.patch(
            f"/v1/characters/{made.character_id}", json={"bones": {"LeftShoulder": None}}
        ),
        "deleteCharacter": lambda: client.delete(f"/v1/characters/{made.session_id}"),
        "createSession": lambda: client.post("/v1/sessions", files=form(made.capture, {})[:-1]),
        "createSession.manifest": lambda: client.post(
            "/v1/sessions", files=[*form(made.capture, {})[:-1], ("manifest", (None, json.dumps(manifest)))]
        ),
        "createSession.wrong": lambda: client.post("/v1/sessions", json=WIDE),
        "listSessions": lambda: client.get("/v1/sessions", params={"limit": 100, "name": "a"}),
        "getSession": lambda: client.get(session),
        "deleteSessionVideos": lambda: client.delete(f"{session}/videos"),
        "deleteSession": lambda: client.delete(f"/v1/sessions/{made.job_id}"),
        "renameSession": lambda: client.patch(session, json={"name": str(next(names))}),
        "getSessionVideo": lambda: client.get(f"{session}/videos/cam_00"),
        "getSessionThumbnail": lambda: client.get(f"{session}/thumbnails/cam_00/0"),
        "createSessionAndJob": lambda: client.post("/v1/jobs", files=form(made.capture, {"exports": ["csv"]})),
        "createSessionAndJob.wrong": lambda: client.post("/v1/jobs", json={"spec": WIDE}),
        "createSessionAndJob.deep": lambda: client.post("/v1/jobs", content=b"[" * 60_000),
        "listJobs": lambda: client.get("/v1/jobs", params={"limit": 100}),
        "createJob": made.job,
        "createJob.wrong": lambda: client.post(f"{session}/jobs", json=WIDE),
        "listSessionJobs": lambda: client.get(f"{session}/jobs", params={"limit": 100}),
        "getJob": lambda: client.get(job),
        "deleteJob": lambda: client.delete(f"/v1/jobs/{made.job()}"),
        "listAttempts": lambda: client.get(f"{job}/attempts"),
        "cancelJob": lambda: client.post(f"/v1/jobs/{made.job()}/cancel"),
        "retryJob": lambda: client.post(f"{job}/retry"),
        "makeJobVisuals": lambda: client.post(f"{job}/visuals"),
        "streamJobEvents": made.events,
        "createLink": lambda: client.post(f"{job}/links", json=link),
        "listLinks": lambda: client.get(f"{job}/links"),
        "revokeLink": lambda: client.delete(f"/v1/links/{made.link_id}"),
        "listResults": lambda: client.get(f"{job}/results"),
        "getAllResults": lambda: client.get(f"{job}/results.zip"),
        "getResult": lambda: client.get(f"{job}/results/skeletons.json"),
        "getMotionDescription": lambda: client.get(f"{job}/motion/description"),
        "getFirstPeople": lambda: client.get(f"{job}/motion/first-people"),
        "getMotion": lambda: client.get(f"{job}/motion", params={"from": 0, "to": 100_000}),
        "getSessionEdits": lambda: client.get(f"{session}/edits", params={"job_id": made.job_id}),
        "editSession": lambda: client.put(f"{session}/edits", json={"edits": edits(), "job_id": made.job_id}),
        "editSession.wrong": lambda: client.put(f"{session}/edits", json={"edits": [[]] * 15_000}),
        "addJobFiles": lambda: client.post(f"{job}/files", json={"exports": ["glb"]}),
        "openRecording": lambda: client.post("/v1/recordings", json={"name": "x"}),
        "listRecordings": lambda: client.get("/v1/recordings", params={"limit": 100}),
        "getRecording": lambda: client.get(recording),
        "renewRecordingLink": lambda: client.post(f"{recording}/join"),
        "createTakeSession": lambda: client.post(f"{recording}/takes/1/session", json={"job": {}}),
        "createTakeCalibration": lambda: client.post(f"{recording}/takes/1/calibration", json={"method": "people"}),
        "deleteRecording": lambda: client.delete(f"/v1/recordings/{made.job_id}"),
        "listLiveDevices": lambda: client.get("/v1/live/devices"),
        "getOptions": lambda: client.get("/v1/options"),
        "getSample": lambda: client.get("/v1/sample"),
        "getSampleFile": lambda: client.get("/v1/sample/Calib.qca.txt"),
        "getCaller": lambda: client.get("/v1/caller"),
        "openBrowserSession": lambda: client.post(
            "/v1/browser-session", headers={"Authorization": "Bearer mc_" + "x" * 60}
        ),
        "closeBrowserSession": lambda: client.delete("/v1/browser-session"),
        "getHealth": lambda: client.get("/healthz"),
        "getReadiness": lambda: client.get("/readyz"),
        "getMetrics": lambda: client.get("/metrics"),
        "contract": lambda: client.get("/openapi.json"),
    }


@contextmanager
def hammered(request: Callable[[], object]) -> Iterator[list[int]]:
    """Send a request again and again by all threads during the block; the numbers of answers by thread."""
    ended, counts = threading.Event(), [0] * NUM_THREADS

    def send(number: int) -> None:
        while not ended.is_set():
            request()
            counts[number] += 1

    with ThreadPoolExecutor(NUM_THREADS) as pool:
        sent = [pool.submit(send, number) for number in range(NUM_THREADS)]
        yield counts
        ended.set()
        for future in sent:
            future.result()


def prepare(client: httpx2.Client) -> Costly:
    files = keypoint_files(simulate(num_views=3))
    job = client.post("/v1/jobs", files=form(files, {})).raise_for_status().json()
    for _ in range(NUM_JOBS):
        client.post(f"/v1/sessions/{job['session_id']}/jobs", json={"exports": ["csv"]}).raise_for_status()
    calibration = {"calibration": ("calibration.json", files["calibration.json"])}
    made = client.post("/v1/calibrations", files=calibration).raise_for_status().json()
    files["robot.glb"] = character(bones_of("default"))
    robot = client.post("/v1/characters", files={"character": ("r.glb", files["robot.glb"])}).raise_for_status().json()
    wait_for(lambda: not client.get("/v1/jobs", params={"state": "queued"}).json()["jobs"], timeout_s=600.0)
    wait_for(lambda: client.get(f"/v1/jobs/{job['id']}").json()["state"] == "succeeded", timeout_s=120.0)
    address = f"/v1/jobs/{job['id']}/links"
    link = client.post(address, json={"scope": "job", "expires_in_s": 60}).raise_for_status().json()
    recording = client.post("/v1/recordings", json={"name": "Rehearsal"}).raise_for_status().json()
    made_ids = made["id"], robot["id"], link["id"], recording["id"]
    return Costly(client, files, job["session_id"], job["id"], *made_ids)


def test_every_operation_is_driven() -> None:
    paths = json.loads(CONTRACT.read_text("utf-8"))["paths"].values()
    operations = {
        operation["operationId"] for path in paths for operation in path.values() if "operationId" in operation
    }
    # The operations with one kind of body have the handlers of those with both.
    operations = {name for name in operations if not name.endswith(("FromFiles", "FromUploads"))}
    driven = requests_of(Costly(httpx2.Client(), {"calibration.json": b"", "robot.glb": b""}, "", "", "", "", "", ""))
    assert {name.partition(".")[0] for name in driven} - {"contract"} == operations


def test_costly_requests_of_one_tenant_delay_no_other(tmp_path: Path) -> None:
    store = JobStore(f"sqlite:///{tmp_path / 'multicap.db'}")
    store.migrate()
    costly, other = (store.keys.add(name, name, {Scope.READ, Scope.WRITE}, None)[1] for name in ("costly", "other"))
    store.close()
    delays: dict[str, float] = {}
    with serving(tmp_path) as served:
        headers = [{"Authorization": f"Bearer {secret}"} for secret in (costly, other)]
        address = served.client.base_url
        with (
            httpx2.Client(base_url=address, headers=headers[0], timeout=120.0, trust_env=False) as client,
            httpx2.Client(base_url=address, headers=headers[1], timeout=120.0, trust_env=False) as neighbour,
        ):
            made = prepare(client)
            for name, request in ({"nothing": lambda: time.sleep(0.1)} | requests_of(made)).items():
                if not name.startswith(ONLY):
                    continue
                waited_s = []
                with hammered(request) as counts:
                    begun_s = time.monotonic()
                    while time.monotonic() - begun_s < DURATION_S:
                        sent_s = time.monotonic()
                        neighbour.get("/v1/jobs").raise_for_status()
                        waited_s.append(time.monotonic() - sent_s)
                        time.sleep(0.02)
                delays[name] = float(np.percentile(waited_s, 99))
                print(f"{name:28} p99 {delays[name] * 1e3:7.0f} ms of {len(waited_s):4}, {sum(counts):6} answers")  # noqa: T201
    assert {name: delay_s for name, delay_s in delays.items() if delay_s > MAX_P99_S} == {}
