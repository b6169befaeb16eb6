"""Children that don't outlive their parent, not even when it is killed.

As a program, ``python -m worker.process.lifeline PARENT -- COMMAND...`` becomes the command, tied to the process
``PARENT`` that started it.
"""

import ctypes
import os
import signal
import sys
from collections.abc import Sequence

from pipeline.runtime.child_processes import module_command

_PR_SET_PDEATHSIG = 1


def die_with_parent(parent: int) -> None:
    """Have the kernel kill this process when ``parent``, which forked it, ends; survives ``exec``, not ``fork``.

    Linux only; elsewhere nothing happens, and a killed parent leaves its children to be stopped by hand.
    """
    if sys.platform == "linux":
        libc = ctypes.CDLL(None, use_errno=True)
        if libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0) != 0:
            raise OSError(ctypes.get_errno(), "prctl")
    # It may have ended before it was asked for.
    if os.getppid() != parent:
        os._exit(1)


def tied(command: Sequence[str]) -> list[str]:
    """Command that runs ``command`` tied to the process that calls this."""
    return module_command("worker.process.lifeline", str(os.getpid()), "--", *command)


def main() -> None:
    """Tie this process to its parent and become the command."""
    parent, _, *command = sys.argv[1:]
    die_with_parent(int(parent))
    os.execv(command[0], command)  # noqa: S606 - the whole point: no shell, no new process


if __name__ == "__main__":
    main()
