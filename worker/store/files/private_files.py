"""Files that only their owner may read: captures of people, webhook secrets, logs."""

import contextlib
import os
from pathlib import Path

_OWNER_ONLY = 0o077
_MODE = 0o700
_OURS = ("multicap.db", "artifacts", "serve.lock")


def keep_files_private() -> None:
    """Make new files of this process and its children readable by their owner only."""
    os.umask(_OWNER_ONLY)


def make_private(folder: Path) -> None:
    """Make the data folder if it is missing, and close it to other users.

    Folders of older versions were open. A folder with other files stays as it is: it was named by mistake. So does a
    folder of another owner, such as a volume of containers.
    """
    folder.mkdir(mode=_MODE, parents=True, exist_ok=True)
    with contextlib.suppress(PermissionError):
        if not any(folder.iterdir()) or any((folder / name).exists() for name in _OURS):
            folder.chmod(_MODE)
