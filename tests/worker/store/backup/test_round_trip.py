"""Backups hold everything, also while others write, and are restored as it was."""

import contextlib
import shutil
import sqlite3
import stat
import subprocess
import sys
import tarfile
import threading
import time
from pathlib import Path

import uuid_utils

from tests.worker.store.backups import UPLOAD, Data, busy_writers, ignore, opened_data, restored
from worker.store.backup.contents import DATABASE, MANIFEST
from worker.store.backup.create import create_backup
from worker.store.backup.restore import verify_backup
from worker.store.files.file_keys import record_key, result_key, stage_key
from worker.store.model.states import JobState


def test_copy_of_file_alone_loses_rows_and_backup_none(data: Data, tmp_path: Path) -> None:
    # The documentation said: "Copy all of them, the database first".
    for _ in range(5):
        data.add_job(data.add_session(100))
    shutil.copy(data.folder / DATABASE, tmp_path / "copy.db")
    with contextlib.closing(sqlite3.connect(tmp_path / "copy.db")) as copy:
        tables = copy.execute("SELECT name FROM sqlite_master WHERE name = 'jobs'").fetchall()
        assert [copy.execute("SELECT count(*) FROM jobs").fetchone() for _ in tables] in ([], [(0,)])
    report = data.back_up(tmp_path / "backup.tar")
    assert report.manifest.rows.jobs == {"queued": 5}
    restored(tmp_path / "backup.tar", tmp_path / "there")
    with opened_data(tmp_path / "there") as there:
        assert there.rows() == data.rows()


def test_restored_service_is_unchanged_and_continues(busy: Data, archive: Path, tmp_path: Path) -> None:
    before, files = busy.rows(), busy.tree()
    assert restored(archive, tmp_path / "there").problems == ()
    with opened_data(tmp_path / "there") as there:
        assert there.rows() == before
        assert there.tree() == files
        assert (there.folder / "uploads" / UPLOAD).read_bytes() == b"half"
        assert there.store.uploads.get(UPLOAD).num_bytes == 8
        there.run_all()
        assert {job.state for job in there.store.jobs.page()} == {JobState.SUCCEEDED}
    modes = {stat.S_IMODE(path.stat().st_mode) for path in (tmp_path / "there").rglob("*") if path.is_file()}
    folders = {stat.S_IMODE(path.stat().st_mode) for path in [tmp_path / "there", tmp_path / "there" / "artifacts"]}
    assert (modes, folders) == ({0o600}, {0o700})
    assert stat.S_IMODE(archive.stat().st_mode) == 0o600
    assert list(busy.folder.joinpath(".backup").iterdir()) == []
    assert sorted(path.name for path in tmp_path.iterdir()) == ["backup.tar", "data", "there"]


def test_other_programs_read_archive(busy: Data, archive: Path, tmp_path: Path) -> None:
    with tarfile.open(archive) as opened:
        assert opened.getnames()[:2] == [MANIFEST, DATABASE]
        opened.extractall(tmp_path / "by-hand", filter="data")
    checked = subprocess.run(["sha256sum", "--check", "--quiet", "SHA256SUMS"], cwd=tmp_path / "by-hand", check=False)
    assert checked.returncode == 0
    with opened_data(tmp_path / "by-hand") as there:
        assert there.rows() == busy.rows()


def test_backup_is_consistent_while_others_write_and_delete(data: Data, tmp_path: Path) -> None:
    found = []
    with busy_writers(data, num_bytes=200_000, num_writers=2):
        for number in range(8):
            time.sleep(0.3)
            archive = tmp_path / f"{number}.tar"
            assert data.back_up(archive).problems == ()
            report = verify_backup(archive, ignore)
            assert (report.problems, report.faults) == ((), ())
            found.append(report.manifest)
    assert found[-1].rows.sessions >= 3
    restored(tmp_path / "7.tar", tmp_path / "there")
    with opened_data(tmp_path / "there") as there:
        assert len(there.store.sessions.page(limit=1000)) == found[-1].rows.sessions


def test_file_deleted_while_it_is_copied_is_in_backup(data: Data, tmp_path: Path) -> None:
    sessions = [data.add_session(3_000_000) for _ in range(3)]
    deleted = threading.Event()

    def delete(done: int, total: int) -> None:
        if not deleted.is_set():
            deleted.set()
            for session_id in sessions:
                data.delete_session(session_id)

    report = create_backup(data.folder, data.url, "", tmp_path / "backup.tar", delete)
    assert (report.problems, report.manifest.rows.sessions) == ((), 3)
    assert verify_backup(tmp_path / "backup.tar", ignore).faults == ()
    assert data.tree() == {}


def test_missing_and_damaged_files_are_listed(busy: Data, tmp_path: Path) -> None:
    running, done = (one.session for one in busy.store.sessions.page())
    (finished,) = [job for job in busy.store.jobs.page() if job.state is JobState.SUCCEEDED]
    lost = {
        done.files[0].key: "missing",
        done.files[1].key: "damaged",
        record_key(running.id): "missing",
        result_key(finished.id, "person-1.bvh"): "damaged",
    }
    output = stage_key(done.id, busy.store.outputs.list_stage(finished.id, "detect")[0].key)
    believed = next(iter(busy.folder.glob(f"artifacts/sessions/{running.id}/stages/*")))
    for key, problem in {**lost, output: "missing"}.items():
        path = busy.folder / "artifacts" / key
        path.unlink() if problem == "missing" else path.write_bytes(b"other")
    believed.unlink()
    outputs = {f"artifacts/{output}", str(believed.relative_to(busy.folder))}
    report = busy.back_up(tmp_path / "backup.tar")
    assert {problem.path: problem.problem for problem in report.lost} == {
        f"artifacts/{key}": problem for key, problem in lost.items()
    }
    assert {problem.path for problem in report.problems if not problem.needed} == outputs
    verified = verify_backup(tmp_path / "backup.tar", ignore)
    assert (verified.faults, verified.problems) == ((), report.problems)
    assert restored(tmp_path / "backup.tar", tmp_path / "there").problems == report.problems
    with opened_data(tmp_path / "there") as there:
        assert there.rows() == busy.rows()
        assert there.tree() == busy.tree()


def test_uploads_that_grow_are_kept_as_far_as_they_were(data: Data, tmp_path: Path) -> None:
    data.add_upload(b"a" * 3_000_000, 9_000_000, UPLOAD)
    data.store.uploads.add(str(uuid_utils.uuid7()), "gone.mp4", 5, "", 3600.0, "host:/uploads")

    def grow(done: int, total: int) -> None:
        with (data.folder / "uploads" / UPLOAD).open("ab") as file:
            file.write(b"b" * 1000)

    report = create_backup(data.folder, data.url, "", tmp_path / "backup.tar", grow)
    assert ([problem.problem for problem in report.problems], report.lost) == (["missing"], ())
    restored(tmp_path / "backup.tar", tmp_path / "there")
    assert (tmp_path / "there" / "uploads" / UPLOAD).read_bytes() == b"a" * 3_000_000


MEASURE = """
import sys; from pathlib import Path; import psutil
from tests.api.processes import peak_bytes
from tests.worker.store.backups import ignore, opened_data, restored
from worker.store.backup.restore import verify_backup
folder = Path(sys.argv[1])
def peak_mib(): return peak_bytes(psutil.Process()) / 2**20
def go(name):
    with opened_data(folder / name) as data: assert data.back_up(folder / f"{name}.tar").problems == ()
    assert verify_backup(folder / f"{name}.tar", ignore).faults == ()
    restored(folder / f"{name}.tar", folder / f"{name}-there")
go("small")
before = peak_mib()
go("large")
print(peak_mib() - before)
"""


def test_memory_does_not_grow_with_files(tmp_path: Path) -> None:
    for name, num_bytes in (("small", 1000), ("large", 60_000_000)):
        with opened_data(tmp_path / name) as data:
            data.add_session(num_bytes)
    measured = subprocess.run(
        [sys.executable, "-c", MEASURE, tmp_path], check=True, stdout=subprocess.PIPE, text=True, timeout=300
    )
    assert float(measured.stdout) < 20.0
