"""Priority of a process, and its limit on open files and sockets."""

import contextlib
import os
import resource
from pathlib import Path

# Enough for thousands of connections. Some systems allow a billion, for which some programs would allocate a table.
_MAX_DESCRIPTORS = 65_536


def lower_priority(nice: int, pid: int | None = None) -> None:
    """Lower the priority of a process.

    Niceness is from 0 to 19 (lowest priority); ``pid`` is a child that leads its own session, ``None`` this process.
    """
    os.setpriority(os.PRIO_PROCESS, pid or 0, nice)
    # Linux may share processors between sessions first, and each part of the service is a session. Then niceness counts
    # only within the session, and the session has a niceness of its own.
    with contextlib.suppress(OSError):
        Path(f"/proc/{pid or 'self'}/autogroup").write_text(str(nice), encoding="ascii")


def raise_descriptor_limit() -> int:
    """Raise this process's soft limit on open descriptors to the hard one; children inherit it.

    Returns the new limit.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = _MAX_DESCRIPTORS if hard == resource.RLIM_INFINITY else min(hard, _MAX_DESCRIPTORS)
    if soft == resource.RLIM_INFINITY or soft >= wanted:
        return _MAX_DESCRIPTORS if soft == resource.RLIM_INFINITY else soft
    with contextlib.suppress(OSError, ValueError):  # the hard limit was lowered since it was read
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
    return resource.getrlimit(resource.RLIMIT_NOFILE)[0]
