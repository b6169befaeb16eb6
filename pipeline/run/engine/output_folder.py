"""Outputs of finished tasks in a folder of one machine: a cache for later runs, bounded, checked when it is read."""

import contextlib
import fcntl
import hashlib
import io
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

import platformdirs

from pipeline.core.errors import DISK_FULL, PipelineError

MAX_CACHE_BYTES = 2 * 2**30
"""Size to which a cache is cut at the end of a run; outputs that were not used for longest are removed first."""

_DIGEST_BYTES = hashlib.sha256().digest_size
_LOCK = "lock"


def default_cache() -> Path:
    """Folder of the user's cache: ``MULTICAP_CACHE_HOME``, else ``multicap`` in the user's cache folder."""
    chosen = os.environ.get("MULTICAP_CACHE_HOME")
    return Path(chosen).expanduser() if chosen else platformdirs.user_cache_path("multicap", appauthor=False)


def is_usable(folder: Path) -> bool:
    """Make a folder that only its owner can read, unless it exists; return whether it can be written to."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK | os.X_OK)


class OutputFolder:
    """Outputs by key. A file holds the SHA-256 of an output and the output."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def read(self, key: str) -> bytes | None:
        """Read an output; ``None`` if there is none or its file is damaged."""
        path = self.path / key
        try:
            stored = path.read_bytes()
            os.utime(path)
        except OSError:
            return None
        content = stored[_DIGEST_BYTES:]
        return content if hashlib.sha256(content).digest() == stored[:_DIGEST_BYTES] else None

    def copy(self, key: str, target: Path) -> bool:
        """Copy an output to a file; return false if there is none or its file is damaged."""
        path = self.path / key
        try:
            os.utime(path)
            stored = path.open("rb")
        except OSError:
            return False
        with stored, target.open("w+b") as copied:
            digest = stored.read(_DIGEST_BYTES)
            shutil.copyfileobj(stored, copied)
            copied.seek(0)
            return hashlib.file_digest(copied, hashlib.sha256).digest() == digest

    def write(self, key: str, content: bytes | Path) -> None:
        """Store an output, or the content of a file, whole or not at all.

        Raises ``PipelineError`` if the folder can't be written to or the disk is full.
        """
        try:
            with tempfile.NamedTemporaryFile(dir=self.path, prefix="new-", delete=False) as file:
                try:
                    with io.BytesIO(content) if isinstance(content, bytes) else content.open("rb") as source:
                        file.write(hashlib.file_digest(source, hashlib.sha256).digest())
                        source.seek(0)
                        shutil.copyfileobj(source, file)
                    file.close()
                    Path(file.name).replace(self.path / key)
                except BaseException:
                    Path(file.name).unlink(missing_ok=True)
                    raise
        except OSError as error:
            raise _unusable(self.path, error) from error

    def trim(self, max_bytes: int) -> None:
        """Remove the outputs that were not used for longest, until the folder is small enough, and unfinished files."""
        used = 0
        entries = [(entry.stat(), entry) for entry in os.scandir(self.path) if entry.is_file() and entry.name != _LOCK]
        for stat, entry in sorted(entries, key=lambda pair: -pair[0].st_mtime_ns):
            used += stat.st_size
            if used > max_bytes or entry.name.startswith("new-"):
                Path(entry.path).unlink(missing_ok=True)


@contextlib.contextmanager
def output_folder(cache: Path | None, max_bytes: int = MAX_CACHE_BYTES) -> Iterator[OutputFolder]:
    """Open a cache of outputs for a run, or a temporary folder.

    Runs share a cache; it is trimmed at the end of a run, when no other run uses it. ``cache`` is made if it is
    missing, readable by its owner alone; ``None``: a temporary folder. Raises ``PipelineError`` if the folder can't be
    used.
    """
    with contextlib.ExitStack() as stack:
        try:
            if cache is None:
                path = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="multicap-")))
            else:
                path = cache
                path.mkdir(mode=0o700, parents=True, exist_ok=True)
            lock = stack.enter_context((path / _LOCK).open("wb"))
            fcntl.flock(lock, fcntl.LOCK_SH)
        except OSError as error:
            raise _unusable(cache or Path(tempfile.gettempdir()), error) from error
        folder = OutputFolder(path)
        try:
            yield folder
        finally:
            if cache is not None:
                with contextlib.suppress(OSError):  # another run uses it, and trims it
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    folder.trim(max_bytes)


def _unusable(path: Path, error: OSError) -> PipelineError:
    reason = "the disk is full" if error.errno in DISK_FULL else (error.strerror or type(error).__name__).lower()
    return PipelineError(
        f"Intermediate outputs can't be stored in {path}: {reason}. Free space, or choose another folder: by "
        "--cache or MULTICAP_CACHE_HOME for the cache, by TMPDIR for temporary files."
    )
