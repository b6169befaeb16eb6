"""Verify and restore backups."""

import contextlib
import fcntl
import hashlib
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO

from filelock import FileLock, Timeout

from worker.store.backup import contents, snapshot
from worker.store.backup.archive import ArchiveReader, BackupError, BackupUsageError, Member, writing_to
from worker.store.database.connection import sqlite_path
from worker.store.errors import DamagedDatabase, UnknownSchema
from worker.store.files.disk import sync
from worker.store.files.file_keys import is_key

OnProgress = Callable[[int, int], None]

_MAX_DOCUMENT_BYTES = 256 * 2**20
# More faults would not help.
_MAX_FAULTS = 100

# Folder of an unfinished restore, in a data folder that existed and was empty.
_UNFINISHED = ".restoring"
_FOLDERS = ("artifacts", "uploads")


class _BackupReader:
    """Reader of a backup, member by member; extracts the files into a folder, or only checks them."""

    def __init__(self, file: BinaryIO, folder: Path | None, database: Path, on_progress: OnProgress) -> None:
        self._folder, self._database = folder, database
        self.archive_bytes = os.fstat(file.fileno()).st_size
        self._done, self._on_progress = 0, on_progress
        self._reader = ArchiveReader(file, self._on_bytes)
        self._expected: dict[str, contents.StoredFile] = {}
        self._seen: set[str] = set()
        self._differing: set[str] = set()
        self._faults: list[str] = []
        self._problems: tuple[contents.FileProblem, ...] | None = None
        self._manifest: contents.BackupManifest | None = None

    def read(self, accept: Callable[[contents.BackupManifest], None]) -> contents.BackupReport:
        """Read all members; ``accept`` may refuse the manifest. The report lists problems as ``faults``."""
        for number, member in enumerate(self._reader.members()):
            if number == 0:
                self._manifest = contents.read_manifest(_document(member, contents.MANIFEST))
                accept(self._manifest)
            elif number == 1:
                self._read_database(member)
            elif self._problems is not None:
                raise BackupError(f"The archive holds {member.name!r} behind its end: no backup of Multicap does.")
            elif member.name == contents.PROBLEMS:
                self._read_problems(member)
            else:
                self._read_file(member)
        if self._manifest is None or self._problems is None:
            raise BackupError("The archive is not a backup of Multicap: a part of it is missing.")
        self._compare(self._problems)
        return contents.BackupReport(self._manifest, self.archive_bytes, self._problems, tuple(self._faults))

    def _on_bytes(self, num_bytes: int) -> None:
        self._done += num_bytes
        self._on_progress(self._done, self.archive_bytes)

    def _read_database(self, member: Member) -> None:
        if member.name != contents.DATABASE:
            raise BackupError(f"The archive holds {member.name!r} where its database should be.")
        _extract(member, self._database)
        assert self._manifest is not None  # noqa: S101 - the first member
        try:
            with writing_to(self._database):
                snapshot.prepare(self._database)
            with snapshot.reading(self._database) as connection:
                self._expected = contents.named_files(connection, with_artifacts=not self._manifest.artifacts_url)
        except BackupError as error:
            self._refuse(*error.faults)
        except DamagedDatabase as error:
            self._refuse(f"The database is damaged: {error.reason}.")
        except UnknownSchema as error:
            self._refuse(str(error))
        except Exception as error:  # a damaged or hostile database may raise anything
            self._refuse(f"The database can't be read: {str(error) or type(error).__name__}.")

    def _read_problems(self, member: Member) -> None:
        try:
            self._problems = contents.FILE_PROBLEMS.validate_json(_document(member, contents.PROBLEMS))
        except ValueError as error:
            raise BackupError(f"The archive's {contents.PROBLEMS} can't be read: it is damaged.") from error

    def _read_file(self, member: Member) -> None:
        _require_path(member.name)
        stored = self._expected.get(member.name)
        if stored is None:
            self._refuse(f"The archive holds {member.name!r}, which its database does not name.")
        digest = hashlib.sha256()
        if self._folder is None:
            for block in member.blocks:
                digest.update(block)
        else:
            _extract(member, self._folder / member.name, digest.update)
        self._seen.add(member.name)
        if stored is not None and stored.sha256 not in {None, digest.hexdigest()}:
            self._differing.add(member.name)

    def _refuse(self, *faults: str) -> None:
        """End a restore; a verification continues, to list all problems."""
        if self._folder is not None:
            raise BackupError(*faults)
        self._faults.extend(faults[: _MAX_FAULTS - len(self._faults)])

    def _compare(self, problems: tuple[contents.FileProblem, ...]) -> None:
        """Add faults of files that were not known when the backup was made."""
        known = {problem.path for problem in problems}
        missing, damaged = self._expected.keys() - self._seen - known, self._differing - known
        faults = [
            *(f"{name} is damaged in the archive." for name in self._reader.damaged),
            *self._faults,
            *(f"{path} is missing in the archive." for path in sorted(missing)),
            *(f"{path} is not what the database says." for path in sorted(damaged - {*self._reader.damaged})),
        ]
        more = len(faults) - _MAX_FAULTS
        self._faults = faults if more <= 0 else [*faults[:_MAX_FAULTS], f"There are {more} more faults."]


def verify_backup(archive: Path, on_progress: OnProgress) -> contents.BackupReport:
    """Read and check a backup as ``restore_backup`` does; the report lists problems as ``faults``.

    Raises ``BackupError`` if the archive can't be read to its end.
    """
    with _opened(archive) as file, tempfile.TemporaryDirectory(prefix="multicap-verify-") as folder:
        database = Path(folder) / contents.DATABASE
        with writing_to(database):
            return _BackupReader(file, None, database, on_progress).read(lambda _: None)


def restore_backup(
    archive: Path, data_dir: Path, database_url: str, artifacts_url: str, on_progress: OnProgress
) -> contents.BackupReport:
    """Restore a backup into a new or empty data folder. Everything is checked before the folder gets its name.

    - ``archive``: path of the backup.
    - ``data_dir``, ``database_url``, ``artifacts_url``: as in the settings of the service that is to run. A database
      elsewhere must be empty.
    - ``on_progress``: called with the number of bytes read, and of all bytes.
    - Returns contents of the backup; ``problems`` lists files that were missing or damaged when it was made.
    - Raises ``BackupError``: nothing was restored.
    - Raises ``UnknownSchema``: a newer version of Multicap wrote the database at ``database_url``.
    """
    data_dir = data_dir.absolute()

    def accept(manifest: contents.BackupManifest) -> None:
        _require_same_store(manifest, artifacts_url)

    with _opened(archive) as file, writing_to(data_dir), _unfinished(data_dir) as folder:
        database = folder / contents.DATABASE
        _require_database(database_url, data_dir)
        _require_room(file, data_dir)
        report = _BackupReader(file, folder, database, on_progress).read(accept)
        if report.faults:
            raise BackupError(*report.faults)
        for name in _FOLDERS:
            (folder / name).mkdir(mode=0o700, exist_ok=True)
        _sync_all(folder)
        _place_database(database, database_url, data_dir)
        _finish(folder, data_dir)
    return report


@contextlib.contextmanager
def _opened(archive: Path) -> Iterator[BinaryIO]:
    try:
        file = archive.open("rb")
    except OSError as error:
        raise BackupUsageError(f"{archive} can't be read: {error.strerror}.") from error
    with file:
        yield file


def _document(member: Member, name: str) -> bytes:
    if member.name != name or member.num_bytes > _MAX_DOCUMENT_BYTES:
        raise BackupError(f"The archive is not a backup of Multicap: it holds {member.name!r} where {name} should be.")
    return b"".join(member.blocks)


def _require_path(path: str) -> None:
    """Raise ``BackupError`` unless a backup may write to a path: the archive may be hostile."""
    folder, _, key = path.partition("/")
    if folder not in _FOLDERS or not is_key(key) or (folder == "uploads" and "/" in key):
        raise BackupError(f"The archive holds {path!r}: no backup of Multicap does.")


def _extract(member: Member, path: Path, on_block: Callable[[bytes], None] = lambda _: None) -> None:
    for folder in reversed(path.parents):
        if not folder.exists():
            folder.mkdir(mode=0o700)
    handle = os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY | os.O_NOFOLLOW, 0o600)
    with os.fdopen(handle, "wb") as file:
        for block in member.blocks:
            on_block(block)
            file.write(block)


def _require_same_store(manifest: contents.BackupManifest, artifacts_url: str) -> None:
    if manifest.artifacts_url and not artifacts_url:
        raise BackupUsageError(
            f"The backup's artifacts are at {manifest.artifacts_url}. Set MULTICAP_ARTIFACTS_URL to where they are."
        )
    if artifacts_url and not manifest.artifacts_url:
        raise BackupUsageError(
            "The backup holds its artifacts, and MULTICAP_ARTIFACTS_URL names another place for them. Unset it."
        )


def _require_database(database_url: str, data_dir: Path) -> None:
    path = sqlite_path(database_url)
    if path is None:
        with snapshot.opened(database_url) as server:
            snapshot.require_empty(server)
    elif path.absolute() != data_dir / contents.DATABASE and os.path.lexists(path):
        raise BackupUsageError(f"MULTICAP_DATABASE_URL names {path}, which is there already. Choose another file.")


def _require_room(file: BinaryIO, data_dir: Path) -> None:
    needed = os.fstat(file.fileno()).st_size
    disk = next(folder for folder in [data_dir, *data_dir.parents] if folder.exists())
    free = shutil.disk_usage(disk).free
    if free < needed:
        raise BackupError(
            f"The backup needs {needed / 1e6:,.0f} MB, and the disk of {data_dir} has {free / 1e6:,.0f} MB left. "
            "Make room there, or choose another folder."
        )


@contextlib.contextmanager
def _unfinished(data_dir: Path) -> Iterator[Path]:
    """Folder to restore into, on the file system of the data folder; removed if the block fails.

    It is beside the data folder if that is missing, so that the data folder appears complete. Else it is inside: the
    data folder may be a mounted disk, or its parent belong to another user.
    """
    inside = data_dir.exists()
    folder = data_dir / _UNFINISHED if inside else data_dir.with_name(f"{data_dir.name}.partial")
    if inside:
        _require_unused(data_dir)
    elif not data_dir.parent.is_dir():
        raise BackupUsageError(f"There is no folder {data_dir.parent}. Make it, or choose another one.")
    folder.mkdir(mode=0o700, exist_ok=True)
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        _clear(folder, data_dir if inside else None)
        try:
            yield folder
        except BaseException:
            if folder.exists():
                _clear(folder, data_dir if inside else None)
                folder.rmdir()
            raise
    except BlockingIOError:
        raise BackupUsageError(f"Another restore into {data_dir} is at work. Wait for its end.") from None
    finally:
        os.close(handle)


def _require_unused(data_dir: Path) -> None:
    if not data_dir.is_dir():
        raise BackupUsageError(f"{data_dir} is not a folder. Choose another name.")
    names = {path.name for path in data_dir.iterdir()}
    if "serve.lock" in names:
        try:
            with FileLock(data_dir / "serve.lock", timeout=0):
                pass
        except Timeout as error:
            raise BackupUsageError(f"A service runs on {data_dir}. Restore into another folder.") from error
    # A restore that was killed at its end has moved these folders, but not the database.
    if names and not (_UNFINISHED in names and names <= {_UNFINISHED, *_FOLDERS}):
        raise BackupUsageError(f"{data_dir} is not empty. Restore into a new folder.")


def _clear(folder: Path, data_dir: Path | None) -> None:
    """Remove files of this restore or of a killed one."""
    for path in folder.iterdir():
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink()
    if data_dir is not None:
        for name in _FOLDERS:
            shutil.rmtree(data_dir / name, ignore_errors=True)


def _sync_all(folder: Path) -> None:
    for path, _, names in os.walk(folder):
        for name in names:
            sync(Path(path, name))
        sync(Path(path))


def _place_database(database: Path, database_url: str, data_dir: Path) -> None:
    """Move the database to where the service reads it."""
    path = sqlite_path(database_url)
    if path is None:
        snapshot.load(database, database_url)
        snapshot.remove_database(database)
    elif path.absolute() != data_dir / contents.DATABASE:
        with writing_to(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            partial = path.with_name(f"{path.name}.partial")
            snapshot.new_private_file(partial)
            try:
                shutil.copyfile(database, partial)
                sync(partial)
                partial.rename(path)
            finally:
                partial.unlink(missing_ok=True)
            sync(path.parent)
        snapshot.remove_database(database)


def _finish(folder: Path, data_dir: Path) -> None:
    """Give the complete folder its name; in an existing folder, move the database last."""
    if folder.parent == data_dir:
        for name in (*_FOLDERS, contents.DATABASE):
            if (folder / name).exists():
                (folder / name).rename(data_dir / name)
        folder.rmdir()
        sync(data_dir)
    else:
        folder.rename(data_dir)
        sync(data_dir.parent)
