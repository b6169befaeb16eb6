"""Create a backup of a service, which may be running."""

import contextlib
import fcntl
import importlib.metadata
import os
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import BinaryIO

from worker.store.backup import contents
from worker.store.backup import snapshot as snapshots
from worker.store.backup.archive import ArchiveWriter, BackupError, BackupUsageError, writing_to
from worker.store.backup.linked import HeldFile, HeldFiles, held_files
from worker.store.database.connection import schema_revisions, sqlite_path
from worker.store.files.disk import DiskSpace, sync

# If sessions are deleted between the snapshot and the links, another snapshot is made. Existing links are kept, so that
# it needs few new ones.
_MAX_SNAPSHOTS = 10

OnProgress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True)
class _Snapshot:
    """Snapshot of the database, with the files that its rows name."""

    path: Path
    revision: str
    files: dict[str, contents.StoredFile]
    rows: contents.RowCounts
    held: dict[str, HeldFile]

    @property
    def num_bytes(self) -> int:
        return self.path.stat().st_size + sum(file.num_bytes for file in self.held.values())


def create_backup(
    data_dir: Path, database_url: str, artifacts_url: str, archive: Path, on_progress: OnProgress
) -> contents.BackupReport:
    """Write the database and the files of a service to a new archive, as they are at one moment.

    ``data_dir``, ``database_url``, ``artifacts_url``: as in the settings of the service. Artifacts in a bucket are not
    copied. ``archive``: path of the new file. The file gets this name when it is complete and on disk. ``on_progress``:
    called with bytes written and bytes in all. Returns the contents of the backup; ``problems`` lists files that are
    missing, unreadable or damaged. Raises ``BackupError``, ``DamagedDatabase``, ``UnknownSchema``.
    """
    if not data_dir.is_dir():
        raise BackupUsageError(f"There is no folder {data_dir}. Give the service's folder with --data.")
    if os.path.lexists(archive):
        raise BackupUsageError(f"{archive} is there already. Choose another name.")
    if not archive.parent.is_dir():
        raise BackupUsageError(f"There is no folder {archive.parent}. Make it, or choose another one.")
    created_at = datetime.now(UTC).replace(microsecond=0)
    with writing_to(archive):
        _require_database(database_url)
    with writing_to(archive), _new_file(archive) as (file, part), held_files(data_dir) as links:
        database = part.with_name(f"{part.name}.db")
        try:
            snapshot = _consistent_snapshot(database_url, database, links, with_artifacts=not artifacts_url)
            _require_room(archive, data_dir, snapshot.num_bytes)
            manifest = _manifest(snapshot, created_at, artifacts_url)
            problems = _write(file, manifest, snapshot, on_progress)
        finally:
            snapshots.remove_database(database)
        file.flush()
        os.fsync(file.fileno())
        num_bytes = os.fstat(file.fileno()).st_size
        if os.path.lexists(archive):
            raise BackupUsageError(f"{archive} was made by another program meanwhile. Choose another name.")
        part.rename(archive)
        sync(archive.parent)
    return contents.BackupReport(manifest, num_bytes, problems)


def _require_database(database_url: str) -> None:
    path = sqlite_path(database_url)
    if path is not None and not path.is_file():
        raise BackupUsageError(f"There is no database at {path}. Give the service's folder with --data.")


@contextlib.contextmanager
def _new_file(archive: Path) -> Iterator[tuple[BinaryIO, Path]]:
    """Private file beside the archive; removed at the end of the block unless it was renamed."""
    part = archive.with_name(f"{archive.name}.part")
    _remove_abandoned(part)
    handle = os.open(part, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o600)
    with os.fdopen(handle, "wb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        try:
            yield file, part
        finally:
            part.unlink(missing_ok=True)


def _remove_abandoned(part: Path) -> None:
    """Remove the file of a killed backup; ``BackupUsageError`` if another backup is writing it."""
    try:
        handle = os.open(part, os.O_RDWR | os.O_NOFOLLOW)
    except FileNotFoundError:
        return
    with os.fdopen(handle) as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise BackupUsageError(f"{part} is being written by another backup. Choose another name.") from None
        part.unlink()


def _consistent_snapshot(database_url: str, target: Path, links: HeldFiles, with_artifacts: bool) -> _Snapshot:
    """Take a snapshot with all its files, unless some are missing for good."""
    missing_before: set[str] | None = None
    for _ in range(_MAX_SNAPSHOTS):
        with snapshots.damage_blames_source(database_url):
            revision = snapshots.take_snapshot(database_url, target)
            files, rows = _examine(target, revision, with_artifacts)
        held = {path: found for path in files if (found := links.hold(path)) is not None}
        missing = files.keys() - held.keys()
        if not missing or missing == missing_before:
            break
        missing_before = missing
    return _Snapshot(target, revision, files, rows, held)


def _examine(
    database: Path, revision: str, with_artifacts: bool
) -> tuple[dict[str, contents.StoredFile], contents.RowCounts]:
    """Files that the rows of a snapshot name, and numbers of rows."""
    if revision == schema_revisions()[-1]:
        return _examine_current(database, with_artifacts)
    # The backup keeps the schema of the service, so that the same version can read it.
    copy = database.with_name(f"{database.name}-current")
    try:
        snapshots.new_private_file(copy)
        shutil.copyfile(database, copy)
        return _examine_current(copy, with_artifacts)
    finally:
        snapshots.remove_database(copy)


def _examine_current(database: Path, with_artifacts: bool) -> tuple[dict[str, contents.StoredFile], contents.RowCounts]:
    snapshots.prepare(database)
    try:
        with snapshots.reading(database) as connection:
            return contents.named_files(connection, with_artifacts), contents.count_rows(connection)
    except ValueError as error:
        raise BackupError(f"The service's database names a file that can't be: {error}.") from error


def _require_room(archive: Path, data_dir: Path, num_bytes: int) -> None:
    """Refuse a disk without enough room; the headroom of the service must stay free on its own disk."""
    free = shutil.disk_usage(archive.parent).free
    if archive.parent.stat().st_dev == data_dir.stat().st_dev:
        free = max(0, free - DiskSpace(data_dir).headroom_bytes)
    if free < num_bytes:
        raise BackupError(
            f"The backup needs {num_bytes / 1e6:,.0f} MB, and {archive.parent} has {free / 1e6:,.0f} MB left. "
            "Make room there, or choose another folder."
        )


def _manifest(snapshot: _Snapshot, created_at: datetime, artifacts_url: str) -> contents.BackupManifest:
    return contents.BackupManifest(
        format=contents.FORMAT,
        created_at=created_at,
        multicap_version=importlib.metadata.version("multicap"),
        schema_revision=snapshot.revision,
        artifacts_url=artifacts_url,
        rows=snapshot.rows,
        files=len(snapshot.held),
        num_bytes=sum(file.num_bytes for file in snapshot.held.values()),
    )


def _write(
    file: BinaryIO, manifest: contents.BackupManifest, snapshot: _Snapshot, on_progress: OnProgress
) -> tuple[contents.FileProblem, ...]:
    done, total = 0, snapshot.num_bytes

    def on_bytes(num_bytes: int) -> None:
        nonlocal done
        done += num_bytes
        on_progress(done, total)

    writer = ArchiveWriter(file, int(manifest.created_at.timestamp()), on_bytes)
    writer.add_bytes(contents.MANIFEST, manifest.model_dump_json(indent=1).encode())
    with snapshot.path.open("rb") as database:
        if not writer.add(contents.DATABASE, snapshot.path.stat().st_size, database).is_whole:
            raise BackupError(f"{snapshot.path} can't be read.")
    problems = tuple(
        problem for stored in snapshot.files.values() if (problem := _add(writer, stored, snapshot.held)) is not None
    )
    writer.add_bytes(contents.PROBLEMS, contents.FILE_PROBLEMS.dump_json(problems, indent=1))
    writer.finish()
    return problems


def _add(writer: ArchiveWriter, stored: contents.StoredFile, held: dict[str, HeldFile]) -> contents.FileProblem | None:
    found = held.get(stored.path)
    if found is None:
        return contents.FileProblem(path=stored.path, problem="missing", needed=stored.needed)
    try:
        source = found.path.open("rb")
    except OSError:
        return contents.FileProblem(path=stored.path, problem="unreadable", needed=stored.needed)
    with source:
        copied = writer.add(stored.path, found.num_bytes, source)
    if not copied.is_whole:
        return contents.FileProblem(path=stored.path, problem="unreadable", needed=stored.needed)
    if stored.sha256 not in {None, copied.sha256}:
        return contents.FileProblem(path=stored.path, problem="damaged", needed=stored.needed)
    return None
