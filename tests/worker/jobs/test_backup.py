"""Backups: consistent while others write, whole or refused, and restored as they were."""

import contextlib
import io
import shutil
import signal
import sqlite3
import stat
import subprocess
import sys
import tarfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import uuid_utils
from alembic import command

from tests.worker.jobs.backups import Data, ignore, opened_data, restored
from tests.worker.jobs.database.test_migrations import CONFIG
from worker.jobs.backup.archive import ArchiveWriter
from worker.jobs.backup.contents import DATABASE, MANIFEST, PROBLEMS
from worker.jobs.backup.create import create_backup
from worker.jobs.backup.errors import BackupError, BackupUsageError
from worker.jobs.backup.linked import held_files
from worker.jobs.backup.restore import verify_backup
from worker.jobs.database.connection import Database, schema_revisions
from worker.jobs.errors import NewerDatabase
from worker.jobs.files.artifacts import record_key, result_key, stage_key
from worker.jobs.model import JobState, Scope
from worker.process import embedded

UPLOAD = "01900000-0000-7000-8000-000000000001"


@pytest.fixture
def data(tmp_path: Path) -> Iterator[Data]:
    with opened_data(tmp_path / "data") as data:
        yield data


@pytest.fixture
def busy(data: Data) -> Data:
    """A finished job, one in the middle, one that waits, half an upload and a key."""
    done, other = data.add_session(), data.add_session()
    data.add_job(done)
    data.run_all()
    data.add_job(other)
    data.run_chunk()
    data.add_job(other)
    data.add_upload(b"half", 8, UPLOAD)
    data.store.keys.add("studio", "portal", {Scope.READ})
    return data


@pytest.fixture
def archive(busy: Data, tmp_path: Path) -> Path:
    assert busy.back_up(tmp_path / "backup.tar").problems == ()
    return tmp_path / "backup.tar"


def test_a_copy_of_the_file_alone_loses_rows_and_a_backup_none(data: Data, tmp_path: Path) -> None:
    # What the documentation said: "Copy all of them, the database first".
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


def test_all_is_as_it_was_and_goes_on(busy: Data, archive: Path, tmp_path: Path) -> None:
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


def test_other_programs_read_the_archive(busy: Data, archive: Path, tmp_path: Path) -> None:
    with tarfile.open(archive) as opened:
        assert opened.getnames()[:2] == [MANIFEST, DATABASE]
        opened.extractall(tmp_path / "by-hand", filter="data")
    checked = subprocess.run(["sha256sum", "--check", "--quiet", "SHA256SUMS"], cwd=tmp_path / "by-hand", check=False)
    assert checked.returncode == 0
    with opened_data(tmp_path / "by-hand") as there:
        assert there.rows() == busy.rows()


def test_it_is_consistent_while_others_write_and_delete(data: Data, tmp_path: Path) -> None:
    stopping, errors = threading.Event(), []

    def write() -> None:
        try:
            with opened_data(data.folder) as mine:
                kept: list[str] = []
                while not stopping.is_set():
                    kept.append(mine.add_session(200_000))
                    mine.add_job(kept[-1])
                    mine.run_all()
                    if len(kept) > 3:
                        mine.delete_session(kept.pop(0))
        except Exception as error:
            errors.append(error)

    writers = [threading.Thread(target=write) for _ in range(2)]
    for writer in writers:
        writer.start()
    try:
        found = []
        for number in range(8):
            time.sleep(0.3)
            archive = tmp_path / f"{number}.tar"
            assert data.back_up(archive).problems == ()
            report = verify_backup(archive, ignore)
            assert (report.problems, report.faults) == ((), ())
            found.append(report.manifest)
    finally:
        stopping.set()
        for writer in writers:
            writer.join()
    assert errors == []
    assert found[-1].rows.sessions >= 3
    restored(tmp_path / "7.tar", tmp_path / "there")
    with opened_data(tmp_path / "there") as there:
        assert len(there.store.sessions.page(limit=1000)) == found[-1].rows.sessions


def test_what_is_deleted_while_it_is_copied_is_in_the_backup(data: Data, tmp_path: Path) -> None:
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


def test_missing_and_damaged_files_are_listed_and_the_rest_is_there(busy: Data, tmp_path: Path) -> None:
    running, done = busy.store.sessions.page()
    (finished,) = [job for job in busy.store.jobs.page() if job.state is JobState.SUCCEEDED]
    lost = {
        done.files[0].key: "missing",
        done.files[1].key: "damaged",
        record_key(running.id): "missing",
        result_key(finished.id, "person-1.bvh"): "damaged",
    }
    output = stage_key(done.id, busy.store.outputs.of_stage(finished.id, "detect")[0].key)
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


def attempt(action: Callable[[], object]) -> tuple[str, ...]:
    """Sentences of a refusal; empty if there was none."""
    try:
        action()
    except (BackupError, NewerDatabase) as error:
        return error.faults if isinstance(error, BackupError) else (str(error),)
    return ()


def test_every_cut_is_noticed(archive: Path, tmp_path: Path) -> None:
    content = archive.read_bytes()
    cut = tmp_path / "cut.tar"
    for length in [0, 1, 511, *range(512, len(content), 16_384), len(content) - 1024, len(content) - 1]:
        cut.write_bytes(content[:length])
        for action in (lambda: verify_backup(cut, ignore), lambda: restored(cut, tmp_path / "there")):
            (sentence,) = attempt(action)
            assert "ends at byte" in sentence, (length, sentence)
    assert not (tmp_path / "there").exists()
    cut.write_bytes(content + b"\0")
    assert "damaged at byte" in attempt(lambda: verify_backup(cut, ignore))[0]
    assert "damaged at byte" in attempt(lambda: restored(cut, tmp_path / "there"))[0]


def test_every_flipped_bit_is_noticed(archive: Path, tmp_path: Path) -> None:
    content = archive.read_bytes()
    flipped = tmp_path / "flipped.tar"
    # All of a header and its padding, and then everywhere.
    offsets = [
        *range(0, 1600, 61),
        *range(1600, len(content), len(content) // 50),
        *range(len(content) - 1100, len(content), 211),
    ]
    for offset in offsets:
        bit = 1 << offset % 8
        flipped.write_bytes(content[:offset] + bytes([content[offset] ^ bit]) + content[offset + 1 :])
        assert attempt(lambda: restored(flipped, tmp_path / "there")), offset
        assert attempt(lambda: verify_backup(flipped, ignore)) or verify_backup(flipped, ignore).faults, offset
    assert sorted(path.name for path in tmp_path.iterdir()) == ["backup.tar", "data", "flipped.tar"]


def members(archive: Path) -> list[tuple[str, bytes]]:
    with tarfile.open(archive) as opened:
        return [(one.name, opened.extractfile(one).read()) for one in opened if one.name != "SHA256SUMS"]  # type: ignore[union-attr]


def forged(path: Path, parts: list[tuple[str, bytes]]) -> Path:
    with path.open("wb") as file:
        writer = ArchiveWriter(file, 0, lambda _: None)
        for name, content in parts:
            writer.add(name, len(content), io.BytesIO(content))
        writer.finish()
    return path


@pytest.mark.parametrize(
    "name",
    [
        "/etc/cron.d/evil",
        "../evil",
        "artifacts/../../evil",
        "artifacts/sessions/..",
        "artifacts//etc/passwd",
        "artifacts/.incoming/evil",
        "uploads/a/b",
        "uploads/..",
        "evil",
        "serve.lock",
        "artifacts/never-named",
        "artifacts/" + "a" * 500,
        DATABASE,
    ],
)
def test_hostile_names_are_refused(archive: Path, tmp_path: Path, name: str) -> None:
    parts = members(archive)
    hostile = forged(tmp_path / "hostile.tar", [*parts[:2], (name, b"evil"), *parts[2:]])
    assert attempt(lambda: restored(hostile, tmp_path / "there"))
    assert attempt(lambda: verify_backup(hostile, ignore)) or verify_backup(hostile, ignore).faults
    assert sorted(path.name for path in tmp_path.iterdir()) == ["backup.tar", "data", "hostile.tar"]


@pytest.mark.parametrize(
    "kind",
    [tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.CHRTYPE, tarfile.DIRTYPE, tarfile.FIFOTYPE, tarfile.XHDTYPE,
     tarfile.GNUTYPE_SPARSE],
)  # fmt: skip
def test_links_devices_and_extensions_are_refused(archive: Path, tmp_path: Path, kind: bytes) -> None:
    parts = members(archive)
    with forged(tmp_path / "hostile.tar", parts[:2]).open("r+b") as file:
        end = sum(512 + len(content) + -len(content) % 512 for _, content in parts[:2])
        file.seek(end)
        info = tarfile.TarInfo("artifacts/link")
        info.type, info.linkname, info.size = kind, "/etc/passwd", 8 * 2**30 if kind == tarfile.XHDTYPE else 0
        file.write(info.tobuf(tarfile.GNU_FORMAT))
        file.truncate()
    (sentence,) = attempt(lambda: restored(tmp_path / "hostile.tar", tmp_path / "there"))
    assert f"damaged at byte {end}" in sentence
    assert not (tmp_path / "there").exists()


def test_hostile_databases_are_refused(archive: Path, tmp_path: Path) -> None:
    parts = members(archive)

    def with_database(*statements: str) -> tuple[str, ...]:
        path = tmp_path / "hostile.db"
        path.write_bytes(parts[1][1])
        with contextlib.closing(sqlite3.connect(path)) as database:
            for statement in statements:
                database.execute(statement)
            database.commit()
        hostile = forged(tmp_path / "hostile.tar", [parts[0], (DATABASE, path.read_bytes()), *parts[2:]])
        return attempt(lambda: restored(hostile, tmp_path / "there"))

    assert with_database() == ()
    shutil.rmtree(tmp_path / "there")
    trigger = "CREATE TRIGGER evil AFTER INSERT ON jobs BEGIN DELETE FROM keys; END"
    assert "'evil'" in with_database(trigger)[0]
    assert "no key" in with_database("UPDATE results SET key = '../../../etc/passwd'")[0]
    assert "no key" in with_database("UPDATE uploads SET id = '../x'")[0]
    assert "does not name" in with_database("UPDATE results SET key = 'jobs/x/results/y'")[0]
    assert "no JSON" in with_database("UPDATE sessions SET files = '{'")[0]
    assert "not what the database says" in with_database("UPDATE results SET sha256 = num_bytes")[0]
    assert "a row refers" in with_database("PRAGMA foreign_keys = OFF", "DELETE FROM sessions")[0]
    for statement in ("DROP TABLE results", "DROP TABLE alembic_version", "DELETE FROM alembic_version"):
        assert with_database(statement), statement
    assert not (tmp_path / "there").exists()


def test_archives_that_are_none(archive: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    assert "No such file" in attempt(lambda: verify_backup(other, ignore))[0]
    other.write_bytes(b"PK\3\4" + bytes(5000))
    assert "no backup of Multicap" in attempt(lambda: verify_backup(other, ignore))[0]
    parts = members(archive)
    for some in ([], parts[1:], [parts[0], *parts[2:]], parts[:-1], [*parts, ("artifacts/x", b"")]):
        forged(other, some)
        assert attempt(lambda: verify_backup(other, ignore)), len(some)
    newer = parts[0][1].replace(b'"format": 1', b'"format": 2')
    assert newer != parts[0][1]
    assert "format 2" in attempt(lambda: verify_backup(forged(other, [(MANIFEST, newer), *parts[1:]]), ignore))[0]
    undeclared = [part for part in parts if not part[0].endswith("/record")]
    assert all("is missing" in fault for fault in verify_backup(forged(other, undeclared), ignore).faults)
    assert "is missing" in attempt(lambda: restored(other, tmp_path / "there"))[0]
    assert parts[-1][0] == PROBLEMS


def test_nothing_is_overwritten(busy: Data, archive: Path, tmp_path: Path) -> None:
    content = archive.read_bytes()
    assert "is there already" in attempt(lambda: busy.back_up(archive))[0]
    assert archive.read_bytes() == content
    assert "is not empty" in attempt(lambda: restored(archive, busy.folder))[0]
    with held_files(busy.folder):
        assert "Another backup" in attempt(lambda: busy.back_up(tmp_path / "second.tar"))[0]
    assert "There is no folder" in attempt(lambda: busy.back_up(tmp_path / "no" / "backup.tar"))[0]
    assert not (tmp_path / "second.tar.part").exists()
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(BackupUsageError, match="no database"):
        create_backup(empty, f"sqlite:///{empty / DATABASE}", "", tmp_path / "second.tar", ignore)
    restored(archive, empty)
    with opened_data(empty) as there:
        assert there.rows() == busy.rows()


def test_an_older_schema_is_brought_up_to_date_and_kept_in_the_backup(data: Data, tmp_path: Path) -> None:
    data.add_job(data.add_session())
    data.run_all()
    before = data.store.sessions.page()
    older = schema_revisions()[-2]
    database = Database(data.url)
    with database.writing() as connection:
        CONFIG.attributes["connection"] = connection
        command.downgrade(CONFIG, older)
    database.close()
    report = data.back_up(tmp_path / "backup.tar")
    assert (report.manifest.schema_revision, report.problems) == (older, ())
    restored(tmp_path / "backup.tar", tmp_path / "there")
    with opened_data(tmp_path / "there") as there:
        assert there.store.sessions.page() == before


def test_a_newer_schema_is_refused(busy: Data, archive: Path, tmp_path: Path) -> None:
    parts = members(archive)
    path = tmp_path / "newer.db"
    path.write_bytes(parts[1][1])
    for database in (path, busy.folder / DATABASE):
        with contextlib.closing(sqlite3.connect(database)) as opened:
            opened.execute("UPDATE alembic_version SET version_num = '9999'")
            opened.commit()
    newer = forged(tmp_path / "newer.tar", [parts[0], (DATABASE, path.read_bytes()), *parts[2:]])
    for action in (
        lambda: restored(newer, tmp_path / "there"),
        lambda: busy.back_up(tmp_path / "again.tar"),
        busy.store.migrate,
    ):
        assert "9999" in attempt(action)[0]
    assert not (tmp_path / "there").exists()
    assert not (tmp_path / "again.tar").exists()


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    folder = tmp_path / "disk"
    folder.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=4m", "tmpfs", folder], check=False).returncode != 0:
        pytest.skip("this machine lets us mount nothing")
    yield folder
    subprocess.run(["umount", "--lazy", folder], check=True)


def test_a_small_disk_is_refused_before_and_a_full_one_in_the_middle(
    data: Data, small_disk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for _ in range(2):
        data.add_session(2_000_000)
    assert data.back_up(tmp_path / "backup.tar").problems == ()
    sentence = attempt(lambda: data.back_up(small_disk / "backup.tar"))[0]
    assert "needs 8 MB" in sentence
    assert "needs 8 MB" in attempt(lambda: restored(tmp_path / "backup.tar", small_disk / "there"))[0]
    # Others fill it meanwhile.
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
    for action in (
        lambda: data.back_up(small_disk / "backup.tar"),
        lambda: restored(tmp_path / "backup.tar", small_disk / "there"),
    ):
        assert "is full" in attempt(action)[0]
    assert list(small_disk.iterdir()) == []


CREATE = """
import sys; from pathlib import Path
from tests.worker.jobs.backups import opened_data, restored
what, data, archive = sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3])
print("at work", flush=True)
if what == "create":
    with opened_data(data) as opened: opened.back_up(archive)
else:
    restored(archive, data)
"""


@pytest.mark.parametrize("what", ["create", "restore"])
def test_a_kill_leaves_nothing_under_the_final_name_and_the_next_try_works(
    data: Data, tmp_path: Path, what: str
) -> None:
    for _ in range(6):
        data.add_session(5_000_000)
    archive, there = tmp_path / "backup.tar", tmp_path / "there"
    if what == "restore":
        data.back_up(archive)
    target, other = (archive, data.folder) if what == "create" else (there, archive)
    partial = tmp_path / {"create": "backup.tar.part", "restore": "there.partial"}[what]
    arguments = [what, str(data.folder if what == "create" else there), str(archive)]
    num_killed = 0
    for wait_s in (0.0, 0.05, 0.15):
        with subprocess.Popen([sys.executable, "-c", CREATE, *arguments], stdout=subprocess.DEVNULL) as process:
            deadline_s = time.monotonic() + 30
            while not partial.exists() and process.poll() is None:
                assert time.monotonic() < deadline_s
            time.sleep(wait_s)
            process.send_signal(signal.SIGKILL)
        if process.returncode == 0:
            break
        num_killed += 1
        assert partial.exists()
        assert not target.exists()
    assert num_killed > 0
    assert other.exists()
    if target.exists():  # the last one was quicker than the kill
        shutil.rmtree(target) if target.is_dir() else target.unlink()
    if what == "create":
        assert data.back_up(archive).problems == ()
    restored(archive, there)
    with opened_data(there) as opened:
        assert opened.rows() == data.rows()
        assert opened.tree() == data.tree()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["backup.tar", "data", "there"]
    assert list((data.folder / ".backup").iterdir()) == []


def test_a_restore_that_was_killed_at_its_end_can_be_done_again(busy: Data, archive: Path, tmp_path: Path) -> None:
    there = tmp_path / "there"
    for folder in (".restoring", "artifacts/sessions/x", "uploads"):
        (there / folder).mkdir(parents=True)
    restored(archive, there)
    with opened_data(there) as opened:
        assert opened.rows() == busy.rows()
        assert opened.tree() == busy.tree()


def test_links_of_a_killed_backup_go_when_the_service_starts_and_others_stay(data: Data) -> None:
    data.add_session()
    (path,) = (path for path in data.tree() if "/0-" in path)
    left = data.folder / ".backup" / "7"
    left.parent.mkdir()
    left.write_bytes(b"deleted long ago")
    with embedded.lock(data.folder):
        assert not left.exists()
    with held_files(data.folder) as links:
        assert links.hold(path) is not None
        with embedded.lock(data.folder):
            assert len(list(left.parent.iterdir())) == 1


def test_uploads_that_grow_are_kept_as_far_as_they_were(data: Data, tmp_path: Path) -> None:
    data.add_upload(b"a" * 3_000_000, 9_000_000, UPLOAD)
    data.store.uploads.add(str(uuid_utils.uuid7()), "gone.mp4", 5, "", 3600.0)

    def grow(done: int, total: int) -> None:
        with (data.folder / "uploads" / UPLOAD).open("ab") as file:
            file.write(b"b" * 1000)

    report = create_backup(data.folder, data.url, "", tmp_path / "backup.tar", grow)
    assert ([problem.problem for problem in report.problems], report.lost) == (["missing"], ())
    restored(tmp_path / "backup.tar", tmp_path / "there")
    assert (tmp_path / "there" / "uploads" / UPLOAD).read_bytes() == b"a" * 3_000_000


MEASURE = """
import resource, sys; from pathlib import Path
from tests.worker.jobs.backups import ignore, opened_data, restored
from worker.jobs.backup.restore import verify_backup
folder = Path(sys.argv[1])
def peak_mib(): return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
def go(name):
    with opened_data(folder / name) as data: assert data.back_up(folder / f"{name}.tar").problems == ()
    assert verify_backup(folder / f"{name}.tar", ignore).faults == ()
    restored(folder / f"{name}.tar", folder / f"{name}-there")
go("small")
before = peak_mib()
go("large")
print(peak_mib() - before)
"""


def test_memory_does_not_grow_with_the_files(tmp_path: Path) -> None:
    for name, num_bytes in (("small", 1000), ("large", 60_000_000)):
        with opened_data(tmp_path / name) as data:
            data.add_session(num_bytes)
    measured = subprocess.run(
        [sys.executable, "-c", MEASURE, tmp_path], check=True, stdout=subprocess.PIPE, text=True, timeout=300
    )
    assert float(measured.stdout) < 20.0
