"""Child processes that end with their parent, even if the parent is killed.

The program ``python -m pipeline.core.runtime.parent_watch PARENT -- COMMAND...`` becomes the command and ends with the
process ``PARENT`` that started it.
"""

import ctypes
import os
import signal
import sys
from collections.abc import Sequence

from pipeline.core.runtime.child_processes import module_command

_PR_SET_PDEATHSIG = 1


def die_with_parent(parent: int) -> None:
    """Let the kernel kill this process when its parent ends; this survives ``exec``, not ``fork``.

    On other systems than Linux nothing happens: children of a killed parent have to be stopped by hand. ``parent`` is
    the process that forked this one.
    """
    if sys.platform == "linux":
        libc = ctypes.CDLL(None, use_errno=True)
        if libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0) != 0:
            raise OSError(ctypes.get_errno(), "prctl")
    # The parent may have ended before the call.
    if os.getppid() != parent:
        os._exit(1)


def tied_to_parent(command: Sequence[str]) -> list[str]:
    """Command that runs ``command`` and ends with the calling process."""
    return module_command("pipeline.core.runtime.parent_watch", str(os.getpid()), "--", *command)


def main() -> None:
    """Tie this process to its parent, and replace it by the command."""
    parent, _, *command = sys.argv[1:]
    die_with_parent(int(parent))
    os.execv(command[0], command)  # noqa: S606 - neither a shell nor a new process is wanted


if __name__ == "__main__":
    main()
