"""Folders for what a chunk needs for a while; those of processes that were killed go when another one starts."""

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
    """A folder of this process, gone at the end of the block."""
    with tempfile.TemporaryDirectory(prefix=f"multicap-{os.getpid()}-") as folder:
        yield Path(folder)


def remove_abandoned() -> None:
    """Remove folders of processes that are gone."""
    for folder in Path(tempfile.gettempdir()).iterdir():
        owner = _NAME.fullmatch(folder.name)
        if owner is not None and not is_running(int(owner[1])):
            shutil.rmtree(folder, ignore_errors=True)  # another process may be at it, too


def is_running(pid: int) -> bool:
    """Whether there is a process of this number."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except (OverflowError, PermissionError):
        return True  # no process of ours
    return True
