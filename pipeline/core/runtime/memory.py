"""Memory of the process: settings of glibc's allocator, and a limit. Without glibc only the limit has an effect."""

import ctypes
import resource
import sys

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
