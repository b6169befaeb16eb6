"""Files that nobody but their owner may read: captures of people, webhooks' secrets, logs."""

import contextlib
import os
from pathlib import Path

_OWNER_ONLY = 0o077
_MODE = 0o700
_OURS = ("multicap.db", "artifacts", "serve.lock")


def keep_files_private() -> None:
    """Have all files that this process and its children make be readable by their owner alone."""
    os.umask(_OWNER_ONLY)


def make_private(folder: Path) -> None:
    """Make the data folder if it is missing, and close it to others: then none of them reaches what is in it.

    Folders of an older version were open. A folder that holds other things stays as it is: it was named by mistake. So
    does one of another owner, such as a volume of containers.
    """
    folder.mkdir(mode=_MODE, parents=True, exist_ok=True)
    with contextlib.suppress(PermissionError):
        if not any(folder.iterdir()) or any((folder / name).exists() for name in _OURS):
            folder.chmod(_MODE)
