"""Files of sessions and jobs: inputs, outputs of chunks, results.

::

    sessions/<session>/inputs/<number>-<name>
    sessions/<session>/record
    sessions/<session>/stages/<output key>
    jobs/<job>/results/<name>
"""

import contextlib
import hashlib
import io
import os
import re
import shutil
import stat
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Protocol

from worker.jobs.errors import DamagedArtifact, NotFound
from worker.jobs.files.checksums import VerifiedFile, found, no_check, require_file
from worker.jobs.files.disk import is_disk_full, sync

_KEY = re.compile(r"[A-Za-z0-9_][A-Za-z0-9._-]*(/[A-Za-z0-9_][A-Za-z0-9._-]*)*", re.ASCII)
_UNSAFE = re.compile(r"[^A-Za-z0-9._-]+", re.ASCII)
_MAX_NAME = 100

# A temporary file that nobody has written to for so long was left by a process that was killed.
_ABANDONED_S = 24 * 3600

_ExcInfo = tuple[type[BaseException], BaseException, TracebackType]

_MODE = stat.S_IRUSR | stat.S_IWUSR  # as a new temporary file has it


def session_prefix(session_id: str) -> str:
    """What the keys of all that a session has begin with, but for its jobs' results."""
    return f"sessions/{session_id}/"


def job_prefix(job_id: str) -> str:
    """What the keys of a job's results begin with."""
    return f"jobs/{job_id}/"


def input_key(session_id: str, number: int, name: str) -> str:
    """Where a session's file is; what a client calls it is kept as far as keys allow."""
    return f"{session_prefix(session_id)}inputs/{number}-{_UNSAFE.sub('_', name)[-_MAX_NAME:]}"


def record_key(session_id: str) -> str:
    """Where that is which the preflight found in a session's files, for the workers."""
    return f"{session_prefix(session_id)}record"


def stage_key(session_id: str, output_key: str) -> str:
    """Where a chunk's output is."""
    return f"{session_prefix(session_id)}stages/{output_key}"


def result_key(job_id: str, name: str) -> str:
    """Where a job's result file is."""
    return f"{job_prefix(job_id)}results/{name}"


class ArtifactStore(Protocol):
    """Immutable files under keys.

    A key consists of names of ASCII letters, digits, ``.``, ``_`` and ``-``, with slashes between them; a name begins
    with a letter, a digit or ``_``. Every method raises ``ValueError`` for another key. A file is there whole or not at
    all, and is replaced whole. Where a file is asked for that is not there, ``NotFound`` is raised.

    A file that is read with its SHA-256 has it: ``DamagedArtifact`` is raised otherwise, also when the file is damaged
    while it is read. A process compares a version of a file once (see ``worker.jobs.files.checksums``).
    """

    def put_file(self, key: str, path: Path) -> None:
        """Take a file over: afterwards ``path`` is gone."""

    def put_bytes(self, key: str, data: bytes) -> None:
        """Keep bytes."""

    def open(self, key: str, sha256: str | None = None) -> BinaryIO:
        """Open a file for reading, with seeking; without a digest it is not compared."""

    def local_path(self, key: str, sha256: str, check: Callable[[], None] = no_check) -> AbstractContextManager[Path]:
        """A path to read the file at, inside the block only.

        The file is compared before the block; ``checksums.require_file`` says whether it has changed since. ``check``
        is called while it is compared.
        """

    def size(self, key: str) -> int:
        """Bytes of a file."""

    def exists(self, key: str) -> bool:
        """Whether a file is there."""

    def signed_url(self, key: str, lifetime_s: float) -> str | None:
        """An address that anybody may get the file from for a while; ``None`` where there is no such thing."""

    def delete_prefix(self, prefix: str) -> None:
        """Remove every file whose key begins with ``prefix``, which ends with a slash."""

    def ping(self) -> bool:
        """Whether files can be kept now."""

    def sweep(self) -> None:
        """Remove what a store keeps on this machine beside its files and nobody uses."""


def read_artifact(artifacts: ArtifactStore, key: str, sha256: str | None) -> bytes:
    """Content of a file that fits into memory; ``sha256`` is its digest, ``None`` if nobody knows it.

    Raises
    ------
    NotFound
    DamagedArtifact
    """
    with artifacts.open(key) as file:
        content = file.read()
    if sha256 is not None and hashlib.sha256(content).hexdigest() != sha256:
        raise DamagedArtifact(key)
    return content


def is_key(key: str) -> bool:
    """Whether this is a key."""
    return _KEY.fullmatch(key) is not None


def require_key(key: str) -> None:
    """Raise ``ValueError`` unless this is a key."""
    if not is_key(key):
        raise ValueError(f"{key!r} is no key of an artifact")


def require_prefix(prefix: str) -> None:
    """Raise ``ValueError`` unless this is a key with a slash behind it."""
    if not prefix.endswith("/"):
        raise ValueError(f"{prefix!r} does not end with a slash")
    require_key(prefix.removesuffix("/"))


class LocalArtifacts:
    """Artifacts as files in a folder, on one file system.

    Parameters
    ----------
    root
        The folder; made if missing.
    """

    def __init__(self, root: Path) -> None:
        self._root = root
        self._incoming = root / ".incoming"  # no key begins with a dot
        self._incoming.mkdir(parents=True, exist_ok=True)
        self._remove_abandoned()

    def put_file(self, key: str, path: Path) -> None:
        """Take a file over: renamed where the file system allows, else copied."""
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
        """Keep bytes."""
        target = self._path(key)
        with self._temporary() as temporary:
            temporary.write_bytes(data)
            sync(temporary)
            self._publish(temporary, target)

    def open(self, key: str, sha256: str | None = None) -> BinaryIO:
        """Open a file for reading."""
        path = self._path(key)
        with found(key):
            return path.open("rb") if sha256 is None else io.BufferedReader(VerifiedFile(path, key, sha256))

    @contextlib.contextmanager
    def local_path(self, key: str, sha256: str, check: Callable[[], None] = no_check) -> Iterator[Path]:
        """The file itself."""
        path = self._path(key)
        require_file(path, key, sha256, check)
        yield path

    def size(self, key: str) -> int:
        """Bytes of a file."""
        path = self._path(key)
        if not path.is_file():
            raise NotFound(f"There is no artifact {key}.")
        return path.stat().st_size

    def exists(self, key: str) -> bool:
        """Whether a file is there."""
        return self._path(key).is_file()

    def delete_prefix(self, prefix: str) -> None:
        """Remove a folder with all that is in it."""
        require_prefix(prefix)
        shutil.rmtree(self._path(prefix.removesuffix("/")), onerror=_unless_gone)

    def ping(self) -> bool:
        """Whether files can be kept now."""
        try:
            with self._temporary() as temporary:
                temporary.write_bytes(b"ping")
        except OSError as error:
            return is_disk_full(error)  # how much room there is, is asked elsewhere
        return True

    def signed_url(self, key: str, lifetime_s: float) -> str | None:
        """None: files of a folder have no address."""
        return None

    def sweep(self) -> None:
        """Remove what killed processes left."""
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
        """Give a complete file its name, so that it survives a loss of power."""
        missing = [folder for folder in target.parents if not folder.exists()]
        target.parent.mkdir(parents=True, exist_ok=True)
        temporary.replace(target)
        for folder in [target.parent, *(made.parent for made in missing)]:
            sync(folder)


def _unless_gone(function: object, path: str, error: _ExcInfo) -> None:
    """Go on where another process has removed something in the meantime."""
    if not isinstance(error[1], FileNotFoundError | NotADirectoryError):
        raise error[1]
