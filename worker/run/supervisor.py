"""Supervisor of a few programs: it starts them in order, restarts them after a crash, and stops them together.

No child outlives the supervisor, even if it is killed: each child is tied to it by
``pipeline.core.runtime.parent_watch``. Each child has its own process group, which is killed after the child has ended.
So Ctrl-C in a terminal reaches only the supervisor. It stops all programs at once, then the programs that the others
need until their end. The output of a program goes to a log file, one JSON object a line, rotated while it runs.
"""

import contextlib
import json
import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from logging import LogRecord, makeLogRecord
from logging.handlers import RotatingFileHandler
from pathlib import Path
from typing import IO

from pipeline.core.runtime.parent_watch import tied_to_parent

# Size of one file; with its older parts a log takes at most five times as much.
MAX_FILE_BYTES = 16 * 2**20
NUM_OLD_FILES = 4
# A longer line is split.
_MAX_LINE_BYTES = 2**20
# Time to read the rest of a pipe whose writers have ended.
_REST_S = 1.0


_LOOK_S = 0.1
_FIRST_DELAY_S = 0.5
_LONGEST_DELAY_S = 30.0

# After this time a child counts as started, and its next crash as the first.
_HEALTHY_S = 20.0


class LogFile:
    """Log of a program, ``NAME.log``, with older parts ``NAME.log.1`` to ``NAME.log.4``.

    A line that can't be written, for example on a full disk, is lost: the program must neither wait nor fail. The
    folder of ``path`` is created if it is missing; the file is rotated at ``max_bytes``.
    """

    def __init__(self, path: Path, max_bytes: int = MAX_FILE_BYTES) -> None:
        with contextlib.suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
        self._handler = _Handler(path, maxBytes=max_bytes, backupCount=NUM_OLD_FILES, delay=True, encoding="utf-8")

        self._thread: threading.Thread | None = None

    def follow(self, output: IO[bytes]) -> None:
        """Copy a pipe to the log until the pipe ends; an earlier pipe is copied to its end first."""
        self._thread = threading.Thread(target=self._copy, args=[output, self._thread], name="log", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Write the rest of the last pipe, which has ended, and close the file."""
        if self._thread is not None:
            self._thread.join(_REST_S)
        self._handler.close()

    def _copy(self, output: IO[bytes], before: threading.Thread | None) -> None:
        if before is not None:
            before.join(_REST_S)
        with output:
            while line := output.readline(_MAX_LINE_BYTES):
                if text := line.decode(errors="backslashreplace").rstrip():
                    self._handler.handle(makeLogRecord({"msg": as_json(text)}))


def as_json(line: str) -> str:
    """Return a line that is a JSON object unchanged, and any other line as the event of an object.

    >>> as_json('{"event": "chunk_done"}')
    '{"event": "chunk_done"}'
    """
    if line.startswith("{") and line.endswith("}"):
        return line
    now = datetime.now(UTC).isoformat(timespec="microseconds").replace("+00:00", "Z")
    return json.dumps({"event": line.strip(), "level": "info", "timestamp": now}, sort_keys=True)


class _Handler(RotatingFileHandler):
    """Rotating handler that drops lines that it can't write, and never leaves a part of a line."""

    _num_bytes = 0

    def emit(self, record: LogRecord) -> None:
        path = Path(self.baseFilename)
        try:
            self._num_bytes = path.stat().st_size
        except OSError:  # the file was removed: create it again
            self._num_bytes = 0
            with contextlib.suppress(OSError):
                self.close()
                path.parent.mkdir(parents=True, exist_ok=True)
        super().emit(record)

    def doRollover(self) -> None:  # noqa: N802 - name of the base class
        super().doRollover()
        self._num_bytes = 0

    def handleError(self, record: LogRecord) -> None:  # noqa: N802 - name of the base class
        # The stream keeps the bytes that it could not write, and would try to write them again.
        with contextlib.suppress(OSError):
            self.close()
        with contextlib.suppress(OSError):
            os.truncate(self.baseFilename, self._num_bytes)


@dataclass(frozen=True, slots=True)
class Program:
    """Program that a supervisor keeps running."""

    name: str
    command: Sequence[str]  # Path of an executable, and arguments
    env: Mapping[str, str]  # Whole environment of the program
    pass_fds: Sequence[int] = ()  # Open files that the program inherits
    stop_s: float = 10.0  # Time from SIGTERM until the program is killed
    stops_last: bool = False  # True if the program is stopped only when all others have ended


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

    Programs are in the order of their start, their output in log files (``worker.run.supervisor``) in
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
