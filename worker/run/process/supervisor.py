"""Supervisor of a few programs: it starts them in order, restarts them after a crash, and stops them together.

No child outlives the supervisor, even if it is killed: each child is tied to it by
``pipeline.core.runtime.parent_watch``. Each child has its own process group, which is killed after the child has ended.
So Ctrl-C in a terminal reaches only the supervisor. It stops all programs at once, then the programs that the others
need until their end.
"""

import contextlib
import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from pipeline.core.runtime.parent_watch import tied_to_parent
from worker.run.process.log_files import LogFile

_LOOK_S = 0.1
_FIRST_DELAY_S = 0.5
_LONGEST_DELAY_S = 30.0
# After this time a child counts as started, and its next crash as the first.
_HEALTHY_S = 20.0


@dataclass(frozen=True, slots=True)
class Program:
    """Program that a supervisor keeps running."""

    name: str
    command: Sequence[str]  # Path of an executable, and arguments
    env: Mapping[str, str]  # Whole environment of the program
    pass_fds: Sequence[int] = ()  # Open files that the program inherits
    stop_s: float = 10.0  # Time from SIGTERM until the program is killed
    stops_last: bool = False  # Whether the program is stopped only when all others have ended


@dataclass(slots=True)
class _Child:
    """Program with its running process, or the time of its next start."""

    program: Program
    log: LogFile
    process: subprocess.Popen[bytes] | None = None
    started_s: float = 0.0
    crashes: int = 0
    start_at_s: float = field(default=0.0)


class Supervisor:
    """Keeps programs running.

    Programs are in the order of their start, their output in log files (``worker.run.process.log_files``) in
    ``logs_dir``. ``warn`` gets a sentence for the operator after a crash.
    """

    def __init__(self, programs: Sequence[Program], logs_dir: Path, warn: Callable[[str], None]) -> None:
        self._children = [_Child(program, LogFile(logs_dir / f"{program.name}.log")) for program in programs]
        self._warn = warn
        self._stop = False

    def run(self) -> None:
        """Keep the programs running until SIGINT or SIGTERM; only for the main thread, which gets the signals."""
        with self._stopped_by(signal.SIGINT, signal.SIGTERM):
            try:
                while not self._stop:
                    for child in self._children:
                        self._start_if_ended(child)
                    time.sleep(_LOOK_S)
            finally:
                for last in (False, True):
                    self._end([child for child in self._children if child.program.stops_last is last])

    @contextlib.contextmanager
    def _stopped_by(self, *numbers: signal.Signals) -> Iterator[None]:
        def stop(*_: object) -> None:
            self._stop = True

        before = {number: signal.signal(number, stop) for number in numbers}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    def _start_if_ended(self, child: _Child) -> None:
        now_s = time.monotonic()
        if child.process is None:
            if now_s >= child.start_at_s:
                child.process, child.started_s = _start(child), now_s
            return
        status = child.process.poll()
        if status is None:
            return
        _kill_group(child.process)
        child.process = None
        child.crashes = 1 if now_s - child.started_s > _HEALTHY_S else child.crashes + 1
        delay_s = min(_FIRST_DELAY_S * 2 ** (child.crashes - 1), _LONGEST_DELAY_S)
        child.start_at_s = now_s + delay_s
        name = child.program.name
        self._warn(f"The {name} {_ending(status)}; it starts again in {delay_s:g} s. See {name}.log.")

    def _end(self, children: Sequence[_Child]) -> None:
        running = [(child, child.process) for child in children if child.process is not None]
        for _, process in running:
            process.terminate()
        terminated_s = time.monotonic()
        for child, process in running:
            program = child.program
            try:
                process.wait(max(0.0, terminated_s + program.stop_s - time.monotonic()))
            except subprocess.TimeoutExpired:
                self._warn(f"The {program.name} did not end in {program.stop_s:g} s and is killed.")
            _kill_group(process)
            process.wait()
        for child in children:
            child.log.close()


def _start(child: _Child) -> subprocess.Popen[bytes]:
    process = subprocess.Popen(  # noqa: S603 - our own commands
        tied_to_parent(child.program.command),
        env=dict(child.program.env),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        pass_fds=child.program.pass_fds,
        start_new_session=True,
    )
    if process.stdout is not None:
        child.log.follow(process.stdout)
    return process


def _kill_group(process: subprocess.Popen[bytes]) -> None:
    """Kill all processes that are left in the group of a process."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)


def _ending(status: int) -> str:
    return f"was killed by {signal.Signals(-status).name}" if status < 0 else f"ended with exit code {status}"
