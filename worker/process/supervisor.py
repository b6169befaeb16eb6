"""Keep a few programs running as one: started in order, started again when they crash, stopped together.

No child outlives the supervisor, not even when it is killed: each is tied to it by ``worker.process.lifeline``, in a
process group of its own that is swept after it. So Ctrl-C in a terminal reaches the supervisor alone, and it decides
the order: all programs at once, then those that the others need until their end.
"""

import contextlib
import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from worker.process.lifeline import tied
from worker.process.log_files import LogFile

_LOOK_S = 0.1
_FIRST_DELAY_S = 0.5
_LONGEST_DELAY_S = 30.0
# A child that lived this long had started well: the next crash counts as the first.
_HEALTHY_S = 20.0


@dataclass(frozen=True, slots=True)
class Program:
    """A program to keep running.

    Parameters
    ----------
    command
        Begins with the path of an executable.
    env
        Its whole environment.
    pass_fds
        Open files that it inherits.
    stop_s
        How long it may take to end after SIGTERM before it is killed.
    stops_last
        Whether it is stopped only when all others have ended.
    """

    name: str
    command: Sequence[str]
    env: Mapping[str, str]
    pass_fds: Sequence[int] = ()
    stop_s: float = 10.0
    stops_last: bool = False


@dataclass(slots=True)
class _Child:
    """A program and its present process, or when to start it next."""

    program: Program
    log: LogFile
    process: subprocess.Popen[bytes] | None = None
    started_s: float = 0.0
    crashes: int = 0
    start_at_s: float = field(default=0.0)


class Supervisor:
    """Runs programs.

    Parameters
    ----------
    programs
        What to run, in the order of starting.
    logs_dir
        Each program's output goes to a file there, see ``worker.process.log_files``.
    say
        Tells a person what happened, a sentence each.
    """

    def __init__(self, programs: Sequence[Program], logs_dir: Path, say: Callable[[str], None]) -> None:
        self._children = [_Child(program, LogFile(logs_dir / f"{program.name}.log")) for program in programs]
        self._say = say
        self._stop = False

    def run(self) -> None:
        """Keep the programs running until SIGINT or SIGTERM; for the main thread, which gets the signals."""
        with self._stopped_by(signal.SIGINT, signal.SIGTERM):
            try:
                while not self._stop:
                    for child in self._children:
                        self._look_after(child)
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

    def _look_after(self, child: _Child) -> None:
        now_s = time.monotonic()
        if child.process is None:
            if now_s >= child.start_at_s:
                child.process, child.started_s = _start(child), now_s
            return
        status = child.process.poll()
        if status is None:
            return
        _sweep(child.process)
        child.process = None
        child.crashes = 1 if now_s - child.started_s > _HEALTHY_S else child.crashes + 1
        delay_s = min(_FIRST_DELAY_S * 2 ** (child.crashes - 1), _LONGEST_DELAY_S)
        child.start_at_s = now_s + delay_s
        name = child.program.name
        self._say(f"The {name} {_ending(status)}; it starts again in {delay_s:g} s. See {name}.log.")

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
                self._say(f"The {program.name} did not end in {program.stop_s:g} s and is killed.")
            _sweep(process)
            process.wait()
        for child in children:
            child.log.close()


def _start(child: _Child) -> subprocess.Popen[bytes]:
    process = subprocess.Popen(  # noqa: S603 - commands are ours
        tied(child.program.command),
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


def _sweep(process: subprocess.Popen[bytes]) -> None:
    """Kill what is left of a process's group."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)


def _ending(status: int) -> str:
    return f"was killed by {signal.Signals(-status).name}" if status < 0 else f"ended with exit code {status}"
