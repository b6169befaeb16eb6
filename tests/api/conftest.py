"""The service on a free port, in this process, with a small program in place of the preflight."""

import contextlib
import hashlib
import shutil
import socket
import sqlite3
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import httpx2
import pytest
import structlog
import uvicorn

from api.web.app import create_app
from api.web.dependencies import Services
from api.web.http.server import server_config
from api.web.settings import Settings
from pipeline.core.findings import Finding
from pipeline.core.options.edits import PersonSpan
from tests.warm_programs import WarmPrograms
from worker.store.files.file_keys import result_key
from worker.store.model.job_records import Result
from worker.store.model.work import Claim

# Replaces the real preflight: the first bytes of a video choose the behaviour.
PREFLIGHT = """
import hashlib, json, pathlib, sys, time
arguments = sys.argv[1:]
if not {"--calibration"} < {"--calibration", "--videos", "--keypoints"}.intersection(arguments):
    # A calibration alone, or the videos of one that is to be made.
    file = pathlib.Path(arguments[1]).name
    print(json.dumps({"problems": [{"code": "calibration_unreadable", "message": "No calibration.", "file": file,
                                    "camera": None, "field": None, "hint": None}]}))
    sys.exit(2)
at = arguments.index("--calibration")
kind = next((word for word in ("--videos", "--keypoints") if word in arguments), None)
videos = [pathlib.Path(name) for name in arguments[arguments.index(kind) + 1 : at]] if kind else []
problems = []
for video in videos:
    with video.open("rb") as file:
        start = file.read(5)
    if start == b"HANG!":
        time.sleep(60)
    if start == b"CRASH":
        raise RuntimeError(f"{video} is a secret")
    if start == b"BABEL":
        print("x" * 10_000_000)
        sys.exit(0)
    if start in {b"APART", b"TWICE"}:
        code, field = {b"APART": ("no_overlap", "offset_s"), b"TWICE": ("duplicate_recording", None)}[start]
        problems.append({"code": code, "message": "Check it.", "file": None, "camera": video.stem, "field": field,
                         "hint": None})
    if start == b"WRONG":
        problems.append({"code": "video_unreadable", "message": "No video.", "file": video.name, "camera": video.stem,
                         "field": None, "hint": "Send a video."})
calibration = pathlib.Path(arguments[at + 1])
if calibration.stat().st_size == 0:
    problems.append({"code": "calibration_empty", "message": "No cameras.", "file": calibration.name, "camera": None,
                     "field": "cameras", "hint": None})
if problems:
    print(json.dumps({"problems": problems}))
    sys.exit(2)
if kind is None:
    print(json.dumps({"format": "multicap", "units": "m", "axes": "Z up", "warnings": [],
                      "text": '{"cameras": []}'}))
    sys.exit(0)
pathlib.Path(arguments[arguments.index("--record") + 1]).write_bytes(b"record")
recordings = [said for one in arguments if one.startswith("--recordings=") for said in json.loads(one[13:])]
cameras = [{"name": video.stem, "file": video.name, "size_px": [640, 480], "frame_rate_hz": 25.0, "num_frames": 60,
            "media_type": None if video.suffix == ".avi" else "video/mp4", "media_start_s": 0.08}
           for video in videos]
if kind == "--videos" and "--thumbnails" in arguments:
    folder = pathlib.Path(arguments[arguments.index("--thumbnails") + 1])
    for place, camera in enumerate(cameras):
        content = f"picture of {camera['name']}".encode()
        (folder / f"{place}-0.jpg").write_bytes(content)
        digest = hashlib.sha256(content).hexdigest()
        camera["thumbnails"] = [{"time_s": 1.2, "num_bytes": len(content), "sha256": digest}]
findings = [{"code": "same_place", "message": "The cameras are close together.", "severity": "info"}]
if videos and videos[0].read_bytes()[:5] == b"MILES":
    findings = [{"code": code, "message": "Check it.", "camera": None, "severity": "error", "hint": "Mend it.",
                 "evidence": {}} for code in ("world_unit", "upside_down")]
print(json.dumps({"cameras": cameras, "timebase": {"start_time_s": 0.0, "frame_rate_hz": 25.0, "num_frames": 60},
                  "stretches": [[0, 60]], "findings": findings, "recordings": recordings}))
"""

# Address without a broker: publishing fails at once, which is allowed.
NO_BROKER = "redis://127.0.0.1:1/0"

RESULT = bytes(range(256)) * 4

# Outputs of the chunks of a job that wait, but for those of its last stage, and their end.
OUTPUTS_BETWEEN = """
INSERT OR IGNORE INTO artifacts (session_id, output_key, sha256, num_bytes)
SELECT :session, output_key, :sha256, :num_bytes FROM chunks WHERE job_id = :job AND state = 'waiting'
AND stage_index < (SELECT max(stage_index) FROM chunks WHERE job_id = :job)
"""
CHUNKS_BETWEEN = """
UPDATE chunks SET state = 'done', done_units = unit_count,
    (started_at, finished_at) = (SELECT started_at, started_at FROM chunks WHERE id = :chunk)
WHERE job_id = :job AND state = 'waiting' AND stage_index < (SELECT max(stage_index) FROM chunks WHERE job_id = :job)
"""


@dataclass
class Live:
    """Running service."""

    client: httpx2.Client
    address: tuple[str, int]
    services: Services

    @property
    def settings(self) -> Settings:
        return self.services.settings

    def kept(self) -> list[Path]:
        """All files of sessions and uploads that the service stores."""
        folders = (self.settings.spool_dir, self.settings.uploads_dir, self.settings.data_dir / "artifacts")
        return [path for folder in folders for path in folder.rglob("*") if path.is_file()]

    def post_session(self, videos: int = 2, **options: Any) -> httpx2.Response:
        return self.client.post("/v1/sessions", files=form(videos), **options)

    def session_id(self) -> str:
        answer = self.post_session()
        assert answer.status_code == 201, answer.text
        return str(answer.json()["id"])

    def job_id(self) -> str:
        answer = self.client.post(f"/v1/sessions/{self.session_id()}/jobs", json={})
        assert answer.status_code == 202, answer.text
        return str(answer.json()["id"])

    def finish(
        self,
        job_id: str,
        content: bytes = RESULT,
        warnings: Sequence[Finding] = (),
        motion: Mapping[str, bytes] = MappingProxyType({}),
        people: Sequence[PersonSpan] | None = None,
        overlays: Mapping[str, bytes] = MappingProxyType({}),
        scenes: Mapping[str, bytes] = MappingProxyType({}),
        names: Mapping[str, str] = MappingProxyType({}),
        characters: Mapping[str, bytes] = MappingProxyType({}),
        each_chunk: bool = False,
    ) -> None:
        """Finish a job as a worker would; ``motion``, ``overlays``, ``scenes`` and ``characters`` are files by name.

        They are files for viewers, videos, GLB or FBX files of everybody, or of a person as in ``person-1.glb``, and
        GLB files of characters; ``names`` are those of people. Only chunks of the first and the last stage are claimed,
        unless ``each_chunk``: the others end at once, which takes a sixth of the time.
        """
        revision = self.services.store.jobs.get(job_id).revision
        result = self._put(job_id, "person-1.bvh", "bvh", content, revision)
        files = [result, *(self._put(job_id, name, "viewer", one, revision) for name, one in motion.items())]
        videos = [self._put(job_id, name, "overlay", one, revision) for name, one in overlays.items()]
        files += [replace(video, media_type="video/mp4") for video in videos]
        of_all = [self._put(job_id, name, name.rpartition(".")[2], one, revision) for name, one in scenes.items()]
        files += [
            replace(scene, media_type="model/gltf-binary", person_name=names.get(scene.name.partition(".")[0]))
            for scene in of_all
        ]
        moved = [self._put(job_id, name, "character", one, revision) for name, one in characters.items()]
        files += [replace(character, media_type="model/gltf-binary") for character in moved]
        while claim := self.services.store.leases.claim("test", 30.0):
            assert claim.job_id == job_id
            if not each_chunk:
                self._end_stages_between(claim, result.sha256, len(content))
            results, said, found = (files, warnings, people) if claim.stage == "export" else ([], (), None)
            self.services.store.leases.finish(
                claim.chunk_id,
                claim.lease_token,
                result.sha256,
                len(content),
                results=results,
                warnings=said,
                people=found,
            )

    def remake(self, job_id: str, **files: object) -> Any:
        """Add files to a job, or make its files again; its answer."""
        return self.client.post(f"/v1/jobs/{job_id}/files", json=files)

    def _end_stages_between(self, claim: Claim, sha256: str, num_bytes: int) -> None:
        """End the stages between that of a claim and the last one, in one transaction: each chunk would take two."""
        values = {"job": claim.job_id, "chunk": claim.chunk_id, "session": claim.session_id}
        values |= {"sha256": sha256, "num_bytes": num_bytes}
        with contextlib.closing(sqlite3.connect(self.settings.data_dir / "multicap.db", 60)) as database, database:
            database.execute(OUTPUTS_BETWEEN, values)
            database.execute(CHUNKS_BETWEEN, values)

    def _put(self, job_id: str, name: str, kind: str, content: bytes, revision: int) -> Result:
        key, digest = result_key(job_id, name, revision), hashlib.sha256(content).hexdigest()
        self.services.artifacts.put_bytes(key, content)
        is_of_person = kind in {"bvh", "character", "fbx", "glb"} and name.startswith("person-")
        stem = name.partition(".")[0] if is_of_person else None
        person = None if stem is None else int(stem.removeprefix("person-"))
        return Result(name, kind, person, "text/plain; charset=utf-8", key, len(content), digest, revision, stem)


def form(videos: int = 2, content: bytes = b"video", calibration: bytes = b"[cam_0]") -> list[tuple[str, Any]]:
    """Parts of a valid session of videos."""
    parts: list[tuple[str, Any]] = [("videos", (f"cam_{index}.mp4", content)) for index in range(videos)]
    return [*parts, ("calibration", ("calibration.toml", calibration))]


def keypoint_form(archives: int = 2) -> list[tuple[str, Any]]:
    """Parts of a valid session of keypoints."""
    parts: list[tuple[str, Any]] = [("keypoints", (f"cam_{index}.zip", b"archive")) for index in range(archives)]
    return [*parts, ("timestamps", ("timestamps.csv", b"camera,frame,time_s")), form(0)[0]]


@contextlib.contextmanager
def running(settings: Settings) -> Iterator[Live]:
    """Run the service on a free port of loopback during the block."""
    app = create_app(settings)
    server = uvicorn.Server(server_config(app, settings.model_copy(update={"host": "127.0.0.1", "port": 0})))
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    deadline_s = time.monotonic() + 120
    while not server.started:
        assert time.monotonic() < deadline_s
        assert thread.is_alive()
        time.sleep(0.01)
    address = server.servers[0].sockets[0].getsockname()
    try:
        with httpx2.Client(base_url=f"http://127.0.0.1:{address[1]}", timeout=120) as client:
            yield Live(client, address, app.state.services)
    finally:
        server.should_exit = True
        thread.join(120)


@pytest.fixture(autouse=True)
def quiet_log() -> Iterator[None]:
    structlog.configure(
        logger_factory=structlog.ReturnLoggerFactory(), processors=[structlog.processors.JSONRenderer()]
    )
    yield
    structlog.reset_defaults()


@pytest.fixture(scope="session")
def preflight_command(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, ...]:
    script = tmp_path_factory.mktemp("preflight") / "preflight.py"
    script.write_text(PREFLIGHT, encoding="utf-8")
    return (sys.executable, "-I", "-S", str(script))


@pytest.fixture(scope="session")
def make_settings(
    tmp_path_factory: pytest.TempPathFactory, preflight_command: tuple[str, ...], warm_programs: WarmPrograms
) -> Callable[..., Settings]:
    def make(**changes: Any) -> Settings:
        folder = tmp_path_factory.mktemp("service")
        defaults: dict[str, Any] = {
            "data_dir": folder / "data",
            "broker_url": NO_BROKER,
            "preflight_command": preflight_command,
            "calibration_command": warm_programs.command("pipeline.calibration.on_request"),
            "character_command": warm_programs.command("pipeline.export.character.check_character"),
            "max_file_bytes": 100_000,
            "max_keypoints_bytes": 50_000,
            "max_session_bytes": 250_000,
            "max_calibration_bytes": 10_000,
            "max_json_bytes": 1_000,
            "max_cameras": 4,
        }
        return Settings(**(defaults | changes))

    return make


@pytest.fixture(scope="session")
def service(make_settings: Callable[..., Settings]) -> Iterator[Live]:
    with running(make_settings()) as live:
        yield live


@pytest.fixture
def live(service: Live) -> Iterator[Live]:
    """Running service without sessions and jobs."""
    yield service
    with contextlib.closing(sqlite3.connect(service.settings.data_dir / "multicap.db")) as database, database:
        database.execute("PRAGMA foreign_keys = ON")
        database.execute("DELETE FROM sessions")
        database.execute("DELETE FROM calibrations")
        database.execute("DELETE FROM characters")
        database.execute("DELETE FROM uploads")
    for path in service.settings.uploads_dir.iterdir():
        path.unlink()
    for folder in ("sessions", "jobs", "characters"):
        shutil.rmtree(service.settings.data_dir / "artifacts" / folder, ignore_errors=True)


def raw(address: tuple[str, int], request: bytes) -> bytes:
    """Send raw bytes, and read the whole response."""
    with socket.create_connection(address[:2], timeout=180) as connection:
        connection.sendall(request)
        connection.shutdown(socket.SHUT_WR)
        answer = b""
        while block := connection.recv(65536):
            answer += block
        return answer


def problem_of(answer: httpx2.Response, status: int, code: str) -> dict[str, Any]:
    """Check that a response is a documented problem; return its body."""
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    problem: dict[str, Any] = answer.json()
    assert set(problem) == {
        "type", "title", "status", "detail", "instance", "code", "errors", "camera", "stage", "hint", "retryable",
        "request_id",
    }  # fmt: skip
    assert problem["status"] == status
    assert problem["code"] == code
    assert problem["request_id"] == answer.headers["x-request-id"]
    assert "Traceback" not in answer.text
    return problem
