"""Temporary folders of chunks; folders of killed processes are removed when another process starts."""

import contextlib
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

_NAME = re.compile(r"multicap-(\d+)-\w+", re.ASCII)


@contextlib.contextmanager
def scratch_folder() -> Iterator[Path]:
    """Create a temporary folder of this process; it is removed at the end of the block."""
    with tempfile.TemporaryDirectory(prefix=f"multicap-{os.getpid()}-") as folder:
        yield Path(folder)


def remove_abandoned() -> None:
    """Remove folders of processes that have ended."""
    for folder in Path(tempfile.gettempdir()).iterdir():
        owner = _NAME.fullmatch(folder.name)
        if owner is not None and not is_running(int(owner[1])):
            shutil.rmtree(folder, ignore_errors=True)  # another process may be removing it, too


def is_running(pid: int) -> bool:
    """Whether there is a process with this id."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except (OverflowError, PermissionError):
        return True  # a process of another user, or an id that no process can have
    return True
