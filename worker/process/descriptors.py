"""Files and sockets that a process may have open."""

import contextlib
import resource

# Enough for thousands of connections. Some systems allow a billion, and programs that keep a table of all would fail.
_MAX_DESCRIPTORS = 65_536


def raise_descriptor_limit() -> int:
    """Raise this process's soft limit on open descriptors to the hard one; children inherit it.

    Returns
    -------
        The soft limit from now on.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = _MAX_DESCRIPTORS if hard == resource.RLIM_INFINITY else min(hard, _MAX_DESCRIPTORS)
    if soft == resource.RLIM_INFINITY or soft >= wanted:
        return _MAX_DESCRIPTORS if soft == resource.RLIM_INFINITY else soft
    with contextlib.suppress(OSError, ValueError):  # the limit of the system was lowered meanwhile
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
    return resource.getrlimit(resource.RLIMIT_NOFILE)[0]
