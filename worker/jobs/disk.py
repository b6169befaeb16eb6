"""What survives a loss of power."""

import os
from pathlib import Path


def sync(path: Path) -> None:
    """Have a file's content, or a folder's list of files, on disk before this returns."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
