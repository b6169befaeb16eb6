"""Files of records that a restored database does not know."""

import time
import uuid

from tests.worker.store.conftest import StoreBench
from worker.store.files.artifacts import ArtifactStore
from worker.store.files.file_keys import record_key, result_key
from worker.store.repositories.work.expiry import orphaned_prefixes, remove_files


def id_of(hours_ago: float) -> str:
    """UUID of version 7 of a moment."""
    milliseconds = int((time.time() - hours_ago * 3600.0) * 1000)
    return str(uuid.UUID(int=(milliseconds << 80) | (0x7 << 76) | (0x2 << 62) | uuid.uuid4().int % 2**62))


def test_files_without_row_are_found_after_day(jobs: StoreBench, artifacts: ArtifactStore) -> None:
    gone, arriving = id_of(hours_ago=25.0), id_of(hours_ago=23.0)
    for session_id in (jobs.session_id, gone, arriving):
        artifacts.put_bytes(record_key(session_id), b"pose")
    artifacts.put_bytes(result_key(gone, "person-1.bvh"), b"pose")
    artifacts.put_bytes("sessions/notes/readme", b"of an operator")
    orphans = orphaned_prefixes(jobs.store.removals, artifacts)
    assert orphans == [f"sessions/{gone}/", f"jobs/{gone}/"]
    jobs.store.removals.add(orphans)
    remove_files(jobs.store.removals, artifacts)
    assert orphaned_prefixes(jobs.store.removals, artifacts) == []
    assert artifacts.exists(record_key(jobs.session_id))
    assert artifacts.exists("sessions/notes/readme")
