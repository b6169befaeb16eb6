"""Limit on the open files and sockets of a process."""

import contextlib
import resource

# Enough for thousands of connections. Some systems allow a billion, for which some programs would allocate a table.
_MAX_DESCRIPTORS = 65_536


def raise_descriptor_limit() -> int:
    """Raise this process's soft limit on open descriptors to the hard one; children inherit it.

    Returns
    -------
        New soft limit.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = _MAX_DESCRIPTORS if hard == resource.RLIM_INFINITY else min(hard, _MAX_DESCRIPTORS)
    if soft == resource.RLIM_INFINITY or soft >= wanted:
        return _MAX_DESCRIPTORS if soft == resource.RLIM_INFINITY else soft
    with contextlib.suppress(OSError, ValueError):  # the hard limit was lowered since it was read
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
    return resource.getrlimit(resource.RLIMIT_NOFILE)[0]
