"""Limits and exit codes of the child processes that open untrusted files. Standard library only.

A file may make FFmpeg or HDF5 crash, hang or exhaust memory, so each file is opened in its own process. If the process
ends by a signal from outside, the file is not to blame.

A child starts for each file, so that its modules import little: arrays are described by ``numpy.typing``, since the
import of jaxtyping takes as long as NumPy's. For several files one process loads the modules, and forks.
"""

import os
import resource
import select
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple, NoReturn

from pipeline.core.errors import ChildError, printable
from pipeline.core.runtime.parent_watch import die_with_parent

MAX_MEMORY_BYTES = 4 * 2**30
_MAX_LOG_BYTES = 2**20
_MAX_OPEN_FILES = 64

READY = b"ready\n"
"""First line of a child's output, before it opens the file. An earlier end of the child is not caused by the file."""

# Signals of a crashing decoder or of a limit. Any other signal comes from outside.
_CAUSED_BY_FILE = {-signal.SIGABRT, -signal.SIGBUS, -signal.SIGFPE, -signal.SIGILL, -signal.SIGSEGV, -signal.SIGXCPU}
_LOGGED_CHARACTERS = 2000

_READ_BYTES = 2**16
_WAIT_S = 0.01


def start_child(max_cpu_s: int | None) -> None:
    """Limit this process's memory, computing time and files, and print the line ``READY``.

    ``None`` is no limit on the time: the parent watches the process of a stream without an end.

    The process opens one file. It writes nothing but its log, and no core dump when it crashes.
    """
    resource.setrlimit(resource.RLIMIT_AS, (MAX_MEMORY_BYTES, MAX_MEMORY_BYTES))
    # SIGXCPU at the first limit, which is caused by the file; SIGKILL, whose cause is unknown, at the second.
    if max_cpu_s is not None:
        resource.setrlimit(resource.RLIMIT_CPU, (max_cpu_s, max_cpu_s + 5))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (_MAX_LOG_BYTES, _MAX_LOG_BYTES))
    resource.setrlimit(resource.RLIMIT_NOFILE, (_MAX_OPEN_FILES, _MAX_OPEN_FILES))
    sys.stdout.buffer.write(READY)
    sys.stdout.flush()


def child_environment() -> dict[str, str]:
    """Environment of a child: without it OpenBLAS would start a thread for each core, which opening a file never uses.

    A process that forks must have no threads.
    """
    return os.environ | {"OPENBLAS_NUM_THREADS": "1"}


class Fork(NamedTuple):
    """End of a forked process."""

    number: int  # Number of its task
    exit_code: int | None  # Negative number of the signal that ended it; ``None``: it was killed after its time limit
    output: bytes  # What it wrote to stdout
    errors: str  # What it wrote to stderr


def run_in_forks(tasks: Sequence[tuple[Callable[[], object], float]], at_once: int) -> Iterator[Fork]:
    """Run each task in a fork of this process, which must have one thread; their ends, in the order of ending.

    Close the generator if it is not read to its end: that kills the forks. They also end with this process.

    Parameters
    ----------
    tasks
        Functions that write to stdout, each with its time limit in seconds.
    at_once
        Largest number of forks at a time.
    """
    waiting = list(enumerate(tasks))[::-1]
    running: list[_Running] = []
    try:
        while waiting or running:
            while waiting and len(running) < at_once:
                number, (task, timeout_s) = waiting.pop()
                running.append(_Running(number, task, timeout_s))
            left_s = max(0.0, min(fork.end_s for fork in running) - time.monotonic())
            readable, _, _ = select.select(running, [], [], left_s)
            now_s = time.monotonic()
            for fork in list(running):
                if (fork in readable and not fork.read()) or now_s >= fork.end_s:
                    running.remove(fork)
                    yield fork.ended()
    finally:
        for fork in running:
            fork.kill()


class _Running:
    """Forked process that runs a task. Its output goes to a pipe, its log to a file."""

    def __init__(self, number: int, task: Callable[[], object], timeout_s: float) -> None:
        self.number, self.end_s = number, time.monotonic() + timeout_s
        self._output = bytearray()
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115 - closed when the process has ended
        self._pipe, writing = os.pipe()
        parent = os.getpid()
        self._process = os.fork()
        if self._process == 0:
            os.dup2(writing, sys.stdout.fileno())
            os.dup2(self._errors.fileno(), sys.stderr.fileno())
            _run(task, parent)
        os.close(writing)

    def fileno(self) -> int:
        """Reading end of the pipe, for ``select``."""
        return self._pipe

    def read(self) -> bool:
        """Read a piece of the output; ``False`` at its end."""
        content = os.read(self._pipe, _READ_BYTES)
        self._output += content
        return bool(content)

    def ended(self) -> Fork:
        """Wait for the end of the process, at most until its time limit."""
        process, status = os.waitpid(self._process, os.WNOHANG)
        while not process and time.monotonic() < self.end_s:
            time.sleep(_WAIT_S)
            process, status = os.waitpid(self._process, os.WNOHANG)
        if not process:
            os.kill(self._process, signal.SIGKILL)
            os.waitpid(self._process, 0)
        self._errors.seek(0)
        errors = self._errors.read().decode(errors="replace")
        self._close()
        return Fork(self.number, os.waitstatus_to_exitcode(status) if process else None, bytes(self._output), errors)

    def kill(self) -> None:
        """Kill the process, and wait for its end."""
        os.kill(self._process, signal.SIGKILL)
        os.waitpid(self._process, 0)
        self._close()

    def _close(self) -> None:
        self._errors.close()
        os.close(self._pipe)


def _run(task: Callable[[], object], parent: int) -> NoReturn:
    """Run a task in the forked process, and end it without what the parent does at its own end."""
    exit_code = 1
    try:
        die_with_parent(parent)
        task()
        sys.stdout.flush()
        exit_code = 0
    except BaseException:
        traceback.print_exc()
        sys.stderr.flush()
    finally:
        os._exit(exit_code)


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
