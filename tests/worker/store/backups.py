"""A service's data with real files, for tests of backups."""

import hashlib
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from tests.worker.store.conftest import LEASE_S, PREFLIGHT, UNITS
from worker.store.backup.contents import BackupReport
from worker.store.backup.create import create_backup
from worker.store.backup.restore import restore_backup
from worker.store.errors import Conflict
from worker.store.files.artifacts import LocalArtifacts
from worker.store.files.file_keys import input_key, record_key, result_key, stage_key
from worker.store.model.job_records import JobRecord, Result
from worker.store.model.rights import Scope
from worker.store.model.session_records import InputFile
from worker.store.model.work import ChunkPlan, StagePlan
from worker.store.repositories.work.expiry import remove_files
from worker.store.spec import JobSpec
from worker.store.store import JobStore

UPLOAD = "01900000-0000-7000-8000-000000000001"


@dataclass(frozen=True)
class Data:
    """A data folder as the API and workers fill it."""

    folder: Path
    url: str
    store: JobStore
    artifacts: LocalArtifacts

    def add_session(self, num_bytes: int = 10_000, name: str = "take") -> str:
        session_id = self.store.sessions.reserve_id()
        files = []
        for number in range(2):
            content = os.urandom(num_bytes)
            key = input_key(session_id, number, f"cam {number}.mp4")
            self.artifacts.put_bytes(key, content)
            files.append(
                InputFile(f"cam {number}.mp4", "video", key, len(content), hashlib.sha256(content).hexdigest())
            )
        self.artifacts.put_bytes(record_key(session_id), b"preflight")
        self.store.sessions.add(name, files, PREFLIGHT, session_id)
        return session_id

    def add_job(self, session_id: str, spec: JobSpec = JobSpec()) -> JobRecord:  # noqa: B008 - frozen
        chunks = tuple(ChunkPlan(k, {}, UNITS, hashlib.sha256(f"detect-{k}".encode()).hexdigest()) for k in range(2))
        last = ChunkPlan(0, {}, UNITS, hashlib.sha256(b"export").hexdigest())
        return self.store.jobs.add(
            session_id, spec, (StagePlan("detect", chunks, ""), StagePlan("export", (last,), ""))
        )

    def run_chunk(self) -> bool:
        """Do the next chunk as a worker does; whether there was one."""
        claim = self.store.leases.claim("worker", LEASE_S)
        if claim is None:
            return False
        content = f"output {claim.output_key}".encode()
        self.artifacts.put_bytes(stage_key(claim.session_id, claim.output_key), content)
        results = []
        if claim.stage == "export":
            key = result_key(claim.job_id, "person-1.bvh")
            self.artifacts.put_bytes(key, b"HIERARCHY")
            sha256 = hashlib.sha256(b"HIERARCHY").hexdigest()
            results.append(Result("person-1.bvh", "bvh", 1, "text/plain", key, 9, sha256))
        digest = hashlib.sha256(content).hexdigest()
        self.store.leases.finish(claim.chunk_id, claim.lease_token, digest, len(content), results=results)
        return True

    def run_all(self) -> None:
        while self.run_chunk():
            pass

    def add_upload(self, content: bytes, num_bytes: int, upload_id: str) -> None:
        self.store.uploads.add(upload_id, "cam.mp4", num_bytes, "", 3600.0, "host:/uploads")
        (self.folder / "uploads").mkdir(exist_ok=True)
        (self.folder / "uploads" / upload_id).write_bytes(content)

    def delete_session(self, session_id: str) -> None:
        self.store.sessions.delete(session_id)
        remove_files(self.store.removals, self.artifacts)

    def back_up(self, archive: Path) -> BackupReport:
        return create_backup(self.folder, self.url, "", archive, ignore)

    def tree(self) -> dict[str, bytes]:
        """Artifacts and uploads."""
        return {
            str(path.relative_to(self.folder)): path.read_bytes()
            for name in ("artifacts", "uploads")
            for path in (self.folder / name).rglob("*")
            if path.is_file()
        }

    def rows(self) -> object:
        jobs = [
            (one.id, one.state, one.attempt, one.created_at, one.stages) for one in self.store.jobs.page(limit=1000)
        ]
        return self.store.sessions.page(limit=1000), jobs, self.store.keys.all(), self.store.figures().totals


def stopped_service(folder: Path) -> Path:
    """Data folder of a stopped service with some hundred pages of rows."""
    with opened_data(folder) as data:
        for _ in range(30):
            data.add_job(data.add_session(100))
        data.run_all()
        data.store.keys.add("studio", "portal", {Scope.READ})
    return folder


def ignore(done: int, total: int) -> None:
    """Progress that nobody looks at."""


@contextmanager
def opened_data(folder: Path, url: str = "") -> Iterator[Data]:
    folder.mkdir(exist_ok=True)
    url = url or f"sqlite:///{folder / 'multicap.db'}"
    store = JobStore(url)
    store.migrate()
    try:
        yield Data(folder, url, store, LocalArtifacts(folder / "artifacts"))
    finally:
        store.close()


def restored(archive: Path, folder: Path, url: str = "") -> BackupReport:
    return restore_backup(archive, folder, url or f"sqlite:///{folder / 'multicap.db'}", "", ignore)


@contextmanager
def busy_writers(data: Data, num_bytes: int, num_writers: int = 1) -> Iterator[None]:
    """Add and delete sessions with jobs in threads during the block; each thread keeps its last three."""
    stopping = threading.Event()
    errors: list[Exception] = []

    def write() -> None:
        try:
            with opened_data(data.folder, data.url) as mine:
                kept: list[str] = []
                while not stopping.is_set():
                    kept.append(mine.add_session(num_bytes))
                    mine.add_job(kept[-1])
                    mine.run_all()
                    if len(kept) > 3:
                        with suppress(Conflict):  # another thread does its last chunk: again in the next round
                            mine.delete_session(kept[0])
                            kept.pop(0)
        except Exception as error:
            errors.append(error)

    writers = [threading.Thread(target=write) for _ in range(num_writers)]
    for writer in writers:
        writer.start()
    try:
        yield
    finally:
        stopping.set()
        for writer in writers:
            writer.join()
    if errors:
        raise ExceptionGroup("writers", errors)
