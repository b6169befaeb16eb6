"""Stores of files under keys: a folder, or a bucket behind it; and interim outputs of unfinished jobs."""

import contextlib
import hashlib
import io
import os
import shutil
import stat
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Protocol

import platformdirs

from worker.store.errors import DamagedArtifact, NotFound
from worker.store.files.checksums import VerifiedFile, missing_is_not_found, no_check, require_file
from worker.store.files.disk import is_disk_full, sync
from worker.store.files.file_keys import interim_key, require_key, require_prefix
from worker.store.model.work import Claim

# A temporary file that was not written to for so long belongs to a killed process.
_ABANDONED_S = 24 * 3600

_ExcInfo = tuple[type[BaseException], BaseException, TracebackType]

_MODE = stat.S_IRUSR | stat.S_IWUSR  # mode of new temporary files

_DIGEST_BYTES = hashlib.sha256().digest_size

# Allowed URLs in the settings of API and workers.
ARTIFACTS_URL = r"^(s3://[^/\s]+(/\S*)?)?$"

DEFAULT_CACHE_BYTES = 64 * 2**30
DEFAULT_CACHE_HOURS = 12.0


class ArtifactStore(Protocol):
    """Immutable files under keys.

    A key consists of names of ASCII letters, digits, ``.``, ``_`` and ``-``, with slashes between them; a name begins
    with a letter, a digit or ``_``. Every method raises ``ValueError`` for another key. A file is stored and replaced
    as a whole. Methods that need a file raise ``NotFound`` if it is missing.

    A file that is opened with its SHA-256 is compared: ``DamagedArtifact`` is raised if the digest differs, also when
    the file is damaged while it is read. A process compares each version of a file once (see
    ``worker.store.files.checksums``).
    """

    def put_file(self, key: str, path: Path) -> None:
        """Store a file and remove ``path``."""

    def put_bytes(self, key: str, data: bytes) -> None:
        """Store bytes."""

    def open(self, key: str, sha256: str | None = None) -> BinaryIO:
        """Open a file for reading, with seeking; without a digest it is not compared."""

    def local_path(self, key: str, sha256: str, check: Callable[[], None] = no_check) -> AbstractContextManager[Path]:
        """Path at which the file can be read, inside the block only.

        The file is compared before the block; ``checksums.require_file`` tells whether it has changed since. ``check``
        is called while the file is compared.
        """

    def size(self, key: str) -> int:
        """Size of a file in bytes."""

    def exists(self, key: str) -> bool:
        """True if a file is stored."""

    def signed_url(self, key: str, lifetime_s: float) -> str | None:
        """Address at which the file can be downloaded for a while without a key; ``None`` if the store has none."""

    def delete(self, key: str) -> None:
        """Remove a file, and copies of it on this machine; it may be missing."""

    def delete_prefix(self, prefix: str) -> None:
        """Remove every file whose key begins with ``prefix``, which ends with a slash."""

    def names(self, prefix: str) -> list[str]:
        """Names of the folders directly below a prefix, which ends with a slash."""

    def ping(self) -> bool:
        """True if files can be stored now."""

    def sweep(self) -> None:
        """Remove temporary files and copies on this machine that are not in use."""


def read_artifact(artifacts: ArtifactStore, key: str, sha256: str | None) -> bytes:
    """Read a file that fits into memory; ``sha256`` is its digest, ``None`` if it is unknown.

    Raises ``NotFound`` or ``DamagedArtifact``.
    """
    with artifacts.open(key) as file:
        content = file.read()
    if sha256 is not None and hashlib.sha256(content).hexdigest() != sha256:
        raise DamagedArtifact(key)
    return content


def copy_artifact(artifacts: ArtifactStore, key: str, sha256: str, path: Path) -> None:
    """Copy a file with a digest. Raises ``NotFound`` or ``DamagedArtifact``."""
    with artifacts.open(key) as file:
        _copy(file, key, bytes.fromhex(sha256), path)


def _copy(file: BinaryIO, key: str, digest: bytes, path: Path) -> None:
    with path.open("w+b") as copied:
        shutil.copyfileobj(file, copied)
        copied.seek(0)
        if hashlib.file_digest(copied, "sha256").digest() != digest:
            raise DamagedArtifact(key)


class LocalArtifacts:
    """Artifacts as files in a folder, on one file system. The folder is made if it is missing."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self._incoming = root / ".incoming"  # no key begins with a dot
        self._incoming.mkdir(parents=True, exist_ok=True)
        self._remove_abandoned()

    def put_file(self, key: str, path: Path) -> None:
        """Store a file: renamed where the file system allows, else copied."""
        target = self._path(key)
        with self._temporary() as temporary:
            try:
                path.replace(temporary)
            except OSError:
                shutil.copyfile(path, temporary)
            temporary.chmod(_MODE)
            sync(temporary)
            self._publish(temporary, target)
        path.unlink(missing_ok=True)

    def put_bytes(self, key: str, data: bytes) -> None:
        """Store bytes."""
        target = self._path(key)
        with self._temporary() as temporary:
            temporary.write_bytes(data)
            sync(temporary)
            self._publish(temporary, target)

    def open(self, key: str, sha256: str | None = None) -> BinaryIO:
        """Open a file for reading."""
        path = self._path(key)
        with missing_is_not_found(key):
            return path.open("rb") if sha256 is None else io.BufferedReader(VerifiedFile(path, key, sha256))

    @contextlib.contextmanager
    def local_path(self, key: str, sha256: str, check: Callable[[], None] = no_check) -> Iterator[Path]:
        """Path of the stored file itself."""
        path = self._path(key)
        require_file(path, key, sha256, check)
        yield path

    def size(self, key: str) -> int:
        """Size of a file in bytes."""
        path = self._path(key)
        if not path.is_file():
            raise NotFound(f"There is no artifact {key}.")
        return path.stat().st_size

    def exists(self, key: str) -> bool:
        """True if a file is stored."""
        return self._path(key).is_file()

    def delete(self, key: str) -> None:
        """Remove a file."""
        self._path(key).unlink(missing_ok=True)

    def delete_prefix(self, prefix: str) -> None:
        """Remove a folder with its content."""
        require_prefix(prefix)
        shutil.rmtree(self._path(prefix.removesuffix("/")), onerror=_unless_gone)

    def names(self, prefix: str) -> list[str]:
        """Names of folders in a folder."""
        require_prefix(prefix)
        folder = self._root / prefix
        return sorted(path.name for path in folder.iterdir() if path.is_dir()) if folder.is_dir() else []

    def ping(self) -> bool:
        """True if files can be stored now."""
        try:
            with self._temporary() as temporary:
                temporary.write_bytes(b"ping")
        except OSError as error:
            return is_disk_full(error)  # room on the disk is checked elsewhere
        return True

    def signed_url(self, key: str, lifetime_s: float) -> str | None:
        """Return ``None``: files of a folder have no address."""
        return None

    def sweep(self) -> None:
        """Remove temporary files of killed processes."""
        self._remove_abandoned()

    def _path(self, key: str) -> Path:
        require_key(key)
        return self._root / key

    @contextlib.contextmanager
    def _temporary(self) -> Iterator[Path]:
        handle, name = tempfile.mkstemp(dir=self._incoming)
        os.close(handle)
        try:
            yield Path(name)
        finally:
            Path(name).unlink(missing_ok=True)

    def _remove_abandoned(self) -> None:
        for path in self._incoming.iterdir():
            with contextlib.suppress(FileNotFoundError):
                if time.time() - path.stat().st_mtime > _ABANDONED_S:
                    path.unlink()

    def _publish(self, temporary: Path, target: Path) -> None:
        """Rename a complete file to its key; it survives a loss of power afterwards."""
        missing = [folder for folder in target.parents if not folder.exists()]
        target.parent.mkdir(parents=True, exist_ok=True)
        temporary.replace(target)
        for folder in [target.parent, *(made.parent for made in missing)]:
            sync(folder)


def _unless_gone(function: object, path: str, error: _ExcInfo) -> None:
    """Ignore files that another process has removed in the meantime."""
    if not isinstance(error[1], FileNotFoundError | NotADirectoryError):
        raise error[1]


def write_interim(artifacts: ArtifactStore, claim: Claim, content: bytes | Path) -> None:
    """Store the interim output of a claimed chunk, bytes or a file."""
    key = interim_key(claim.job_id, claim.job_attempt, claim.output_key)
    if isinstance(content, bytes):
        artifacts.put_bytes(key, hashlib.sha256(content).digest() + content)
        return
    stored = content.with_name(f"stored-{content.name}")
    with content.open("rb") as source, stored.open("wb") as file:
        file.write(hashlib.file_digest(source, "sha256").digest())
        source.seek(0)
        shutil.copyfileobj(source, file)
    artifacts.put_file(key, stored)


def read_interim(artifacts: ArtifactStore, claim: Claim, output_key: str) -> bytes | None:
    """Read the interim output of a chunk of the claim's job by the key of the chunk's output.

    ``None`` if it is missing or damaged.
    """
    try:
        stored = read_artifact(artifacts, interim_key(claim.job_id, claim.job_attempt, output_key), None)
    except NotFound:
        return None
    content = stored[_DIGEST_BYTES:]
    return content if hashlib.sha256(content).digest() == stored[:_DIGEST_BYTES] else None


def copy_interim(artifacts: ArtifactStore, claim: Claim, output_key: str, path: Path) -> None:
    """Copy the interim output of a chunk to a file, as ``read_interim``; raises as ``copy_artifact``."""
    key = interim_key(claim.job_id, claim.job_attempt, output_key)
    with artifacts.open(key) as file:
        digest = file.read(_DIGEST_BYTES)
        _copy(file, key, digest, path)


def default_data_dir() -> Path:
    """Default data folder of the service."""
    return platformdirs.user_data_path("multicap", appauthor=False) / "service"


def open_artifacts(
    url: str, data_dir: Path, cache_bytes: int = DEFAULT_CACHE_BYTES, cache_hours: float = DEFAULT_CACHE_HOURS
) -> ArtifactStore:
    """Open the artifact store at a URL.

    ``url``: ``s3://bucket/prefix``; empty: a folder of ``data_dir``. ``data_dir``: data folder, which holds the
    artifacts, or copies of those in a bucket. ``cache_bytes``, ``cache_hours``: maximum size of the copies, and time
    that unused copies are kept. Raises ``ValueError``: the URL is of no known store.
    """
    if not url:
        return LocalArtifacts(data_dir / "artifacts")
    # The library is loaded only where it is needed.
    from worker.store.files.s3 import FileCache, S3Artifacts  # noqa: PLC0415

    return S3Artifacts(url, FileCache(data_dir / "cache", cache_bytes, cache_hours * 3600.0))
