"""How this process asks the system for memory, and how much it may have; without glibc only the limit has an effect."""

import ctypes
import resource
import sys

# Of glibc's malloc.h.
_M_TRIM_THRESHOLD = -1
_M_MMAP_THRESHOLD = -3
_KEPT_BYTES = 2**28
_LARGEST_KEPT_BYTES = 2**25  # glibc's own limit
_PICTURE_BYTES = 2**21  # of a full HD picture a third; a network's input is smaller


def keep_freed_memory() -> None:
    """Keep what is freed for what comes next, up to a quarter of a GiB; for programs, at their start.

    Else every large array takes fresh pages from the system, one fault a page: a quarter of the time of tracking.
    """
    _mallopt(_M_MMAP_THRESHOLD, _LARGEST_KEPT_BYTES)
    _mallopt(_M_TRIM_THRESHOLD, _KEPT_BYTES)


def give_pictures_back() -> None:
    """Return the memory of every picture to the system as soon as it is freed; before any is decoded.

    The allocator would put buffers of a picture's size into the heap; what stays between them keeps the heap from
    shrinking, and the peak grew by a third from one run to the next. It holds for the process from then on.
    """
    _mallopt(_M_MMAP_THRESHOLD, _PICTURE_BYTES)


def limit_memory(max_bytes: int) -> None:
    """Limit the memory of this process and of children that it starts: beyond it allocations fail (``MemoryError``).

    Counted is what is private and may be written to (``RLIMIT_DATA``): what libraries reserve without using, such as
    heaps of threads, and code are not. A limit that the process was started with stays if it is lower.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
    limits = (max_bytes, *(limit for limit in (soft, hard) if limit != resource.RLIM_INFINITY))
    resource.setrlimit(resource.RLIMIT_DATA, (min(limits), hard))


def _mallopt(parameter: int, value: int) -> None:
    if sys.platform == "linux":
        mallopt = getattr(ctypes.CDLL(None), "mallopt", None)  # other C libraries have none
        if mallopt is not None:
            mallopt(parameter, value)
