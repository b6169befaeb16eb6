"""Limits and exit codes of the child processes that open untrusted files. Standard library only.

A file may make FFmpeg or HDF5 crash, hang or exhaust memory, so each file is opened in its own process. If the process
ends by a signal from outside, the file is not to blame.

A child starts for each file, so that its modules import little: arrays are described by ``numpy.typing``, since the
import of jaxtyping takes as long as NumPy's.
"""

import resource
import signal
import sys

from pipeline.errors import ChildError, printable

MAX_MEMORY_BYTES = 4 * 2**30
_MAX_LOG_BYTES = 2**20
_MAX_OPEN_FILES = 64

READY = b"ready\n"
"""First line of a child's output, before it opens the file. An earlier end of the child is not caused by the file."""

# Signals of a crashing decoder or of a limit. Any other signal comes from outside.
_CAUSED_BY_FILE = {-signal.SIGABRT, -signal.SIGBUS, -signal.SIGFPE, -signal.SIGILL, -signal.SIGSEGV, -signal.SIGXCPU}
_LOGGED_CHARACTERS = 2000


def start_child(max_cpu_s: int) -> None:
    """Limit this process's memory, computing time and files, and print the line ``READY``.

    The process opens one file. It writes nothing but its log, and no core dump when it crashes.
    """
    resource.setrlimit(resource.RLIMIT_AS, (MAX_MEMORY_BYTES, MAX_MEMORY_BYTES))
    # SIGXCPU at the first limit, which is caused by the file; SIGKILL, whose cause is unknown, at the second.
    resource.setrlimit(resource.RLIMIT_CPU, (max_cpu_s, max_cpu_s + 5))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (_MAX_LOG_BYTES, _MAX_LOG_BYTES))
    resource.setrlimit(resource.RLIMIT_NOFILE, (_MAX_OPEN_FILES, _MAX_OPEN_FILES))
    sys.stdout.buffer.write(READY)
    sys.stdout.flush()


def is_caused_by_file(exit_code: int) -> bool:
    """Return whether a child ended by a signal that its file caused."""
    return exit_code in _CAUSED_BY_FILE


def child_error(task: str, exit_code: int | None, timeout_s: float, errors: str) -> ChildError:
    """Build the error of a child that failed for a reason other than its file; its stderr is added as a note.

    ``task`` is such as "check of a.mp4"; ``exit_code`` is ``None`` if the child did not start within ``timeout_s``;
    ``errors`` is its stderr.
    """
    if exit_code is None:
        ending, hint = f"did not start within {timeout_s:g} s", "See that the machine is not overloaded, and try again."
    elif exit_code < 0:
        ending = f"was ended by {signal.Signals(-exit_code).name}"
        hint = "See that there is memory enough (the system's log says), and try again."
    else:
        last = errors.strip().rpartition("\n")[2]
        ending, hint = f"ended with exit code {exit_code} ({last})", "If it happens again, install Multicap anew."
    error = ChildError(f"Multicap's own {printable(task)} failed, the file is not at fault: it {ending}. {hint}")
    error.add_note(f"stderr of the {task}:\n{errors[-_LOGGED_CHARACTERS:]}")
    return error
