"""Processes that stand back, so that what a client waits for is answered while others compute."""

import contextlib
import os
from pathlib import Path


def stand_back(nice: int, pid: int | None = None) -> None:
    """Lower the priority of a process: this one, or a child that leads a session of its own."""
    os.setpriority(os.PRIO_PROCESS, pid or 0, nice)
    # Linux may share processors between sessions first, and each part of the service is one: then a process's niceness
    # only counts within it, and the session has one of its own.
    with contextlib.suppress(OSError):
        Path(f"/proc/{pid or 'self'}/autogroup").write_text(str(nice), encoding="ascii")
