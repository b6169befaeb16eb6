"""Resources of a process: glibc's allocator, garbage collector, files in place of memory, a limit, and priority.

Without glibc only the limit of memory has an effect.
"""

import contextlib
import ctypes
import gc
import mmap
import os
import resource
import sys
import tempfile
from pathlib import Path
from weakref import WeakValueDictionary

# Constants of glibc's malloc.h.
_M_TRIM_THRESHOLD = -1
_M_MMAP_THRESHOLD = -3
_KEPT_BYTES = 2**28
_LARGEST_KEPT_BYTES = 2**25  # glibc's limit of the threshold
_PICTURE_BYTES = 2**21  # a third of a full HD picture; inputs of networks are smaller


def keep_freed_memory() -> None:
    """Keep freed memory for later allocations, up to a quarter of a GiB; to be called at the start of a program.

    Otherwise every large array takes new pages, whose page faults are a quarter of the time of tracking.
    """
    _mallopt(_M_MMAP_THRESHOLD, _LARGEST_KEPT_BYTES)
    _mallopt(_M_TRIM_THRESHOLD, _KEPT_BYTES)


def collect_seldom() -> None:
    """Look for cycles of unused objects less often; to be called at the start of a program.

    Hundreds of thousands of objects of loaded modules stay: looking through them again and again while the modules are
    loaded was a seventh of the processor time of a worker's start.
    """
    gc.set_threshold(50_000, 20, 50)


def give_pictures_back() -> None:
    """Return the memory of each picture to the system when it is freed; to be called before pictures are decoded.

    The setting holds for the rest of the process. By default the allocator puts buffers of a picture's size into the
    heap, where smaller blocks between them keep the heap from shrinking: the peak grew by a third from run to run.
    """
    _mallopt(_M_MMAP_THRESHOLD, _PICTURE_BYTES)


def limit_memory(max_bytes: int) -> None:
    """Limit the memory of this process and of its later children; beyond it allocations raise ``MemoryError``.

    The limit counts private writable memory (``RLIMIT_DATA``), but neither code nor memory that libraries reserve
    without use, such as heaps of threads. A lower limit from the start of the process stays in force.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
    limits = (max_bytes, *(limit for limit in (soft, hard) if limit != resource.RLIM_INFINITY))
    resource.setrlimit(resource.RLIMIT_DATA, (min(limits), hard))


def _mallopt(parameter: int, value: int) -> None:
    if sys.platform == "linux":
        mallopt = getattr(ctypes.CDLL(None), "mallopt", None)  # other C libraries have none
        if mallopt is not None:
            mallopt(parameter, value)


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


_mapped: WeakValueDictionary[int, mmap.mmap] = WeakValueDictionary()


def map_file(num_bytes: int) -> mmap.mmap:
    """Map a temporary file without a name, in the folder of Python's temporary files, as memory.

    Raises ``OSError`` if the disk is full.
    """
    if not _mapped:  # each file that is mapped keeps a descriptor, and many systems allow 256 or 1024 at first
        raise_descriptor_limit()
    with tempfile.TemporaryFile() as file:
        if hasattr(os, "posix_fallocate"):  # else a full disk would end the process at a write
            try:
                os.posix_fallocate(file.fileno(), 0, num_bytes)
            except OSError as error:
                folder = tempfile.gettempdir()
                raise OSError(error.errno, f"{error.strerror} in {folder}, the folder of TMPDIR") from None
        file.truncate(num_bytes)
        mapped = mmap.mmap(file.fileno(), num_bytes)
    _mapped[id(mapped)] = mapped
    return mapped


def release_pages() -> None:
    """Take the pages of all mapped files out of the process; they come back from the system's cache, or the disk."""
    for reference in _mapped.valuerefs():  # unlike an iterator a list: other threads may map files meanwhile
        if (mapped := reference()) is not None:
            mapped.madvise(mmap.MADV_DONTNEED)
