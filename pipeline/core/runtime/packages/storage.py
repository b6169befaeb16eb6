"""Storage folder of downloads and models: location, locks, checksums and atomic writes."""

import contextlib
import errno
import hashlib
import os
from collections.abc import Iterator
from pathlib import Path

import platformdirs

from pipeline.core.errors import ModelError

# Longer than any download in progress.
_LOCK_TIMEOUT_S = 1800


def home() -> Path:
    """Root folder of ``models/``, ``samples/`` and ``downloads/``: ``MULTICAP_HOME``, else the user's data folder."""
    chosen = os.environ.get("MULTICAP_HOME")
    return Path(chosen).expanduser() if chosen else platformdirs.user_data_path("multicap", appauthor=False)


def file_sha256(path: Path) -> str:
    """SHA-256 of a file in hexadecimal digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@contextlib.contextmanager
def storage_errors() -> Iterator[None]:
    """Turn an ``OSError`` in the block into a ``ModelError`` with advice for the user."""
    try:
        yield
    except OSError as error:
        if error.errno in {errno.ENOSPC, errno.EDQUOT}:
            raise ModelError("The disk is full. Free some space, or set MULTICAP_HOME to another folder.") from error
        reason = error.strerror or type(error).__name__
        raise ModelError(f"The storage folder can't be used: {reason}. Set MULTICAP_HOME to another folder.") from error


@contextlib.contextmanager
def exclusive(target: Path, timeout_s: float = _LOCK_TIMEOUT_S) -> Iterator[None]:
    """Lock the creation of ``target`` against other processes; creates the folder of ``target``.

    Raises ``ModelError`` if another process holds the lock for longer than ``timeout_s``, or the folder can't be
    written.
    """
    from filelock import FileLock, Timeout  # noqa: PLC0415 - slow to import, and seldom needed

    with contextlib.ExitStack() as stack:
        with storage_errors():
            target.parent.mkdir(parents=True, exist_ok=True)
            try:
                stack.enter_context(FileLock(target.parent / f"{target.name}.lock", timeout=timeout_s))
            except Timeout as error:
                raise ModelError(f"Another process has been busy with {target.name} for too long; stop it.") from error
        yield


def partial_path(target: Path) -> Path:
    """Path of an incomplete file."""
    return target.with_name(f"{target.name}.part")


def write_file(target: Path, content: bytes) -> None:
    """Write a file under its temporary name and rename it, so that a crash leaves no incomplete file.

    The caller holds ``exclusive(target)``, or owns the folder. Raises ``ModelError`` if the disk is full or the folder
    can't be written.
    """
    part = partial_path(target)
    with storage_errors():
        with part.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        part.replace(target)
