"""Priorities of processes: computing processes get a lower priority than the web API, so that it responds quickly."""

import contextlib
import os
from pathlib import Path


def lower_priority(nice: int, pid: int | None = None) -> None:
    """Lower the priority of a process.

    Parameters
    ----------
    nice
        Niceness, from 0 to 19 (lowest priority).
    pid
        Process id of a child that leads its own session; ``None`` for this process.
    """
    os.setpriority(os.PRIO_PROCESS, pid or 0, nice)
    # Linux may share processors between sessions first, and each part of the service is a session. Then niceness counts
    # only within the session, and the session has a niceness of its own.
    with contextlib.suppress(OSError):
        Path(f"/proc/{pid or 'self'}/autogroup").write_text(str(nice), encoding="ascii")
