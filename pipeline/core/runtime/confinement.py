"""Programs of Multicap that open untrusted files, each in a child process with limits. Standard library only.

A file may make FFmpeg, HDF5 or another library crash, hang or exhaust memory, so each file is opened in its own
process. If the process ends by a signal from outside, the file is not to blame.

The parent calls ``run_confined``; the program begins with ``confined_arguments``, and calls ``tell_ready`` before it
opens its file. A child starts for each file, so that its modules import little: arrays are described by
``numpy.typing``, since the import of jaxtyping takes as long as NumPy's. For several files one process loads the
modules, and forks (``run_in_forks``).
"""

import errno
import json
import os
import resource
import select
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict
from typing import IO, Any, NamedTuple, NoReturn, cast

from pipeline.core.errors import DISK_FULL, ChildError, InputError, Problem, listed, printable
from pipeline.core.runtime import parent_watch
from pipeline.core.runtime.child_processes import module_command, uninterrupted

MAX_MEMORY_BYTES = 4 * 2**30

READY = b"ready\n"
"""Output of a child before it opens the file. An earlier end of the child is not caused by the file."""

EXIT_REFUSED, EXIT_OUT_OF_MEMORY = 3, 4
"""Exit codes of a program that can't use its file, and of one that needs more memory than it may have."""

# Signals of a crashing decoder or of a limit. Any other signal comes from outside.
_CAUSED_BY_FILE = {-signal.SIGABRT, -signal.SIGBUS, -signal.SIGFPE, -signal.SIGILL, -signal.SIGSEGV, -signal.SIGXCPU}
_LOGGED_CHARACTERS = 2000

_READ_BYTES = 2**16
_WAIT_S, _LOOK_S = 0.01, 0.5


class ChildLimits(NamedTuple):
    """ChildLimits of a process that opens a file."""

    cpu_s: int | None  # Computing time; ``None``: unlimited, for a process whose parent watches its time
    memory_bytes: int = MAX_MEMORY_BYTES  # Address space
    file_bytes: int = 2**20  # Size of a file that it writes: its log
    open_files: int = 64


class BeyondLimitsError(Exception):
    """The file makes its process crash, or exceed the limits on time or memory.

    ``is_time`` tells whether the process was ended for its time.
    """

    def __init__(self, is_time: bool) -> None:
        super().__init__("The process ended by a limit or by a crash.")
        self.is_time = is_time


class FileRefusedError(Exception):
    """The program can't use its file, ``EXIT_REFUSED``; the text is what it wrote to stderr."""


class ChildEnd(NamedTuple):
    """End of a child process."""

    exit_code: int | None  # Negative number of the signal that ended it; ``None``: it was killed after the time limit
    is_ready: bool  # True if the child came to its file
    output: bytes  # Output after ``READY``
    errors: str  # Text of the child on stderr


def run_confined(
    program: str,
    arguments: Sequence[str],
    limits: ChildLimits,
    *,
    task: str,
    timeout_s: float,
    given: bytes = b"",
    on_output: Callable[[bytes], object] | None = None,
) -> bytes:
    """Run a program of Multicap that opens an untrusted file; return its output.

    The child has ended when the function returns or raises, and ends with this process.

    - ``program``: module that begins with ``confined_arguments``, named as in a checkout.
    - ``task``: name of what the program does, for the error of a child that fails: "check of a.mp4".
    - ``timeout_s``: longest wait for output.
    - ``given``: content of the program's stdin.
    - ``on_output``: called with each piece of the output; nothing is returned then. An exception from it ends the
      child.
    - Raises ``BeyondLimitsError`` if the file makes the program crash, or exceed its limits on time or memory.
    - Raises ``FileRefusedError`` if the program ends with ``EXIT_REFUSED``.
    - Raises ``ChildError`` if the child fails for a reason other than its file.
    """
    end = run_child(program, arguments, limits, timeout_s, given, on_output)
    check_end(end, task, timeout_s)
    return end.output


def run_child(
    program: str,
    arguments: Sequence[str],
    limits: ChildLimits,
    timeout_s: float,
    given: bytes = b"",
    on_output: Callable[[bytes], object] | None = None,
) -> ChildEnd:
    """Run a program as ``run_confined`` does; return how it ended."""
    output, is_ready, is_ended = bytearray(), False, False
    command = module_command(program, str(os.getpid()), json.dumps(limits), *arguments)
    with tempfile.TemporaryFile() as stdin:
        stdin.write(given)
        stdin.seek(0)
        with started_child(command, stdin) as (child, errors):
            pipe = cast(IO[bytes], child.stdout).fileno()
            poll = select.poll()
            poll.register(pipe, select.POLLIN)
            end_s = time.monotonic() + timeout_s
            while not is_ended and time.monotonic() < end_s:
                # A signal that reached another thread wakes no thread that waits; its handler runs when this one looks.
                if not poll.poll(1000 * min(_LOOK_S, timeout_s)):
                    continue
                output += (content := os.read(pipe, _READ_BYTES))
                is_ended, end_s = not content, time.monotonic() + timeout_s
                if not is_ready and READY in output:
                    is_ready, output = True, output.partition(READY)[2]
                if is_ready and on_output is not None:
                    on_output(bytes(output))
                    output.clear()
            return child_end(child, timeout_s if is_ended else None, is_ready, errors, bytes(output))


def check_end(end: ChildEnd, task: str, timeout_s: float) -> None:
    """Raise the error of a child that failed, see ``run_confined``."""
    if end.exit_code == 0 and end.is_ready:
        return
    if end.exit_code == EXIT_REFUSED:
        raise FileRefusedError(end.errors)
    if end.is_ready and (
        end.exit_code is None or end.exit_code == EXIT_OUT_OF_MEMORY or is_caused_by_file(end.exit_code)
    ):
        raise BeyondLimitsError(end.exit_code in {None, -signal.SIGXCPU})
    raise child_error(task, end.exit_code, timeout_s, end.errors)


@contextmanager
def started_child(
    command: Sequence[str], stdin: IO[bytes] | int, pass_fds: Sequence[int] = ()
) -> Iterator[tuple["subprocess.Popen[bytes]", IO[bytes]]]:
    """Start a child with a pipe for its output and a file for its stderr; kill it at the end of the block."""
    child: subprocess.Popen[bytes] | None = None
    with tempfile.TemporaryFile() as errors:
        try:
            with uninterrupted():
                child = subprocess.Popen(  # noqa: S603 - our own interpreter and module
                    command,
                    stdin=stdin,
                    stdout=subprocess.PIPE,
                    stderr=errors,
                    bufsize=0,
                    env=child_environment(),
                    pass_fds=pass_fds,
                )
            yield child, errors
        finally:
            if child is not None:
                child.kill()
                with child:  # closes the pipes, and waits
                    pass


def child_end(
    child: "subprocess.Popen[bytes]", wait_s: float | None, is_ready: bool, errors: IO[bytes], output: bytes = b""
) -> ChildEnd:
    """Wait for the end of a child that has closed its output; ``wait_s`` is ``None`` if it has not, and is killed."""
    exit_code: int | None = None
    if wait_s is not None:
        with suppress(subprocess.TimeoutExpired):
            exit_code = child.wait(wait_s)
    errors.seek(0)
    return ChildEnd(exit_code, is_ready, output, errors.read().decode(errors="replace"))


def child_environment() -> dict[str, str]:
    """Environment of a child: without it OpenBLAS would start a thread for each core, which opening a file never uses.

    A process that forks must have no threads.
    """
    return os.environ | {"OPENBLAS_NUM_THREADS": "1"}


def confined_arguments() -> list[str]:
    """Limit this process, a program that ``run_confined`` has started, and return its arguments."""
    _, parent, limits, *arguments = sys.argv
    parent_watch.die_with_parent(int(parent))
    confine(ChildLimits(*json.loads(limits)))
    return arguments


def confine(limits: ChildLimits) -> None:
    """Limit this process. It writes no core dump when it crashes."""
    resource.setrlimit(resource.RLIMIT_AS, (limits.memory_bytes, limits.memory_bytes))
    # SIGXCPU at the first limit, which is caused by the file; SIGKILL, whose cause is unknown, at the second.
    if limits.cpu_s is not None:
        resource.setrlimit(resource.RLIMIT_CPU, (limits.cpu_s, limits.cpu_s + 5))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (limits.file_bytes, limits.file_bytes))
    resource.setrlimit(resource.RLIMIT_NOFILE, (limits.open_files, limits.open_files))


def tell_ready() -> None:
    """Tell the parent that everything is loaded, and the file is opened next."""
    sys.stdout.buffer.write(READY)
    sys.stdout.flush()


class Fork(NamedTuple):
    """End of a forked process."""

    number: int  # Number of its task
    exit_code: int | None  # Negative number of the signal that ended it; ``None``: it was killed after its time limit
    output: bytes  # Content of stdout
    errors: str  # Content of stderr


def run_in_forks(tasks: Sequence[tuple[Callable[[], object], float]], at_once: int) -> Iterator[Fork]:
    """Run each task in a fork of this process, which must have one thread; their ends, in the order of ending.

    Close the generator if it is not read to its end: that kills the forks. They also end with this process.

    ``tasks``: functions that write to stdout, each with its time limit in seconds. ``at_once``: largest number of forks
    at a time.
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
        parent_watch.die_with_parent(parent)
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
        ending, hint = f"ended with exit code {exit_code} ({last})", "If it happens again, install Multicap again."
    error = ChildError(f"Multicap's own {printable(task)} failed, the file is not at fault: it {ending}. {hint}")
    error.add_note(f"stderr of the {task}:\n{errors[-_LOGGED_CHARACTERS:]}")
    return error


EXIT_BAD_INPUT = 2
EXIT_DISK_FULL = 4


def print_answer(check: Callable[[], Mapping[str, Any]], too_large: Problem) -> int:
    """Print what a check answers as one JSON object, or ``{"problems": [...]}``; return the program's exit code.

    ``too_large`` is the problem of files that need more memory, or larger files, than the caller allows.
    """
    try:
        answer = check()
    except InputError as error:
        answer = {"problems": [asdict(problem) for problem in listed(error.problems)]}
    except MemoryError:
        answer = {"problems": [asdict(too_large)]}
    except OSError as error:
        if error.errno in DISK_FULL:
            return EXIT_DISK_FULL
        if error.errno != errno.EFBIG:  # the caller's limit, RLIMIT_FSIZE; Python ignores the signal that goes with it
            raise
        answer = {"problems": [asdict(too_large)]}
    sys.stdout.write(json.dumps(answer, allow_nan=False) + "\n")
    return EXIT_BAD_INPUT if "problems" in answer else 0
