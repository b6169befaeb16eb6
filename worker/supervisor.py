"""Keep a few programs running as one: started in order, started again when they crash, stopped in order.

No child outlives the supervisor, not even when it is killed: each is tied to it by ``worker.lifeline``, in a process
group of its own that is swept after it. So Ctrl-C in a terminal reaches the supervisor alone, and it decides the order.
"""

import contextlib
import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from worker.lifeline import tied

_LOOK_S = 0.1
_FIRST_DELAY_S = 0.5
_LONGEST_DELAY_S = 30.0
# A child that lived this long had started well: the next crash counts as the first.
_HEALTHY_S = 20.0
_MAX_LOG_BYTES = 16 * 2**20


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
    """

    name: str
    command: Sequence[str]
    env: Mapping[str, str]
    pass_fds: Sequence[int] = ()
    stop_s: float = 10.0


@dataclass(slots=True)
class _Child:
    """A program and its present process, or when to start it next."""

    program: Program
    process: subprocess.Popen[bytes] | None = None
    started_s: float = 0.0
    crashes: int = 0
    start_at_s: float = field(default=0.0)


class Supervisor:
    """Runs programs, in the order of starting; they are stopped in the reverse order.

    Parameters
    ----------
    programs
        What to run.
    logs_dir
        Each program's output goes to a file there.
    say
        Tells a person what happened, a sentence each.
    """

    def __init__(self, programs: Sequence[Program], logs_dir: Path, say: Callable[[str], None]) -> None:
        self._children = [_Child(program) for program in programs]
        self._logs_dir, self._say = logs_dir, say
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
                for child in reversed(self._children):
                    self._end(child)

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
                child.process, child.started_s = self._start(child.program), now_s
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

    def _start(self, program: Program) -> subprocess.Popen[bytes]:
        self._logs_dir.mkdir(parents=True, exist_ok=True)
        path = self._logs_dir / f"{program.name}.log"
        if path.exists() and path.stat().st_size > _MAX_LOG_BYTES:
            path.replace(path.with_suffix(".log.1"))
        with path.open("ab") as log:
            return subprocess.Popen(  # noqa: S603 - commands are ours
                tied(program.command),
                env=dict(program.env),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                pass_fds=program.pass_fds,
                start_new_session=True,
            )

    def _end(self, child: _Child) -> None:
        if child.process is None:
            return
        child.process.terminate()
        try:
            child.process.wait(child.program.stop_s)
        except subprocess.TimeoutExpired:
            self._say(f"The {child.program.name} did not end in {child.program.stop_s:g} s and is killed.")
        _sweep(child.process)
        child.process.wait()


def _sweep(process: subprocess.Popen[bytes]) -> None:
    """Kill what is left of a process's group."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)


def _ending(status: int) -> str:
    return f"was killed by {signal.Signals(-status).name}" if status < 0 else f"ended with exit code {status}"
