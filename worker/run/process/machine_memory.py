"""Memory of the machine, or of the container, that a worker runs in."""

import os
from pathlib import Path

# Share of the memory that chunks may use: the rest is for the system, and for code.
_SHARE = 0.9
_CGROUPS = Path("/sys/fs/cgroup")
_OF_PROCESS = Path("/proc/self/cgroup")


def machine_memory_bytes(cgroups: Path = _CGROUPS, of_process: Path = _OF_PROCESS) -> int:
    """Memory for all chunks at once: nine tenths of the machine's, or of the least limit of the process's cgroups.

    Parameters
    ----------
    cgroups, of_process
        Folder of cgroups (version 2), and file that names that of this process.
    """
    limits = [os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")]
    try:
        (name,) = (line[len("0::/") :] for line in of_process.read_text().splitlines() if line.startswith("0::/"))
    except (OSError, ValueError):  # no Linux, or cgroups of version 1
        name = ""
    group = cgroups / name
    for folder in (group, *group.parents):
        try:
            limits.append(int((folder / "memory.max").read_text()))
        except (OSError, ValueError):  # the root has no limit; others have "max"
            continue
    return int(_SHARE * min(limits))
