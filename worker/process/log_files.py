"""Log files of programs: what they print, a JSON object a line, rotated while they run."""

import contextlib
import json
import os
import threading
from datetime import UTC, datetime
from logging import LogRecord, makeLogRecord
from logging.handlers import RotatingFileHandler
from pathlib import Path
from typing import IO

# A program's log takes at most five times as much.
MAX_FILE_BYTES = 16 * 2**20
NUM_OLD_FILES = 4
# Longer lines come as several.
_MAX_LINE_BYTES = 2**20
# Until the end of a pipe whose writers have all ended.
_REST_S = 1.0


class LogFile:
    """A program's log, ``NAME.log``, with older parts ``NAME.log.1`` to ``NAME.log.4``.

    A line that can't be written, because the disk is full, is lost: whoever prints must never wait for it, nor fail.

    Parameters
    ----------
    path
        The file; its folder is made if it is missing.
    max_bytes
        Size at which the next part begins.
    """

    def __init__(self, path: Path, max_bytes: int = MAX_FILE_BYTES) -> None:
        with contextlib.suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
        self._handler = _Handler(path, maxBytes=max_bytes, backupCount=NUM_OLD_FILES, delay=True, encoding="utf-8")

        self._thread: threading.Thread | None = None

    def follow(self, output: IO[bytes]) -> None:
        """Write what comes through a pipe from now until its end, once an earlier one has ended."""
        self._thread = threading.Thread(target=self._copy, args=[output, self._thread], name="log", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Write the rest of what came through a pipe that has ended."""
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
    """A line as it is if it is a JSON object, else as the event of one.

    >>> as_json('{"event": "chunk_done"}')
    '{"event": "chunk_done"}'
    """
    if line.startswith("{") and line.endswith("}"):
        return line
    now = datetime.now(UTC).isoformat(timespec="microseconds").replace("+00:00", "Z")
    return json.dumps({"event": line.strip(), "level": "info", "timestamp": now}, sort_keys=True)


class _Handler(RotatingFileHandler):
    """The standard library's, which loses lines that it can't write, and leaves no half of one."""

    _num_bytes = 0

    def emit(self, record: LogRecord) -> None:
        path = Path(self.baseFilename)
        try:
            self._num_bytes = path.stat().st_size
        except OSError:  # removed by somebody: begin anew
            self._num_bytes = 0
            with contextlib.suppress(OSError):
                self.close()
                path.parent.mkdir(parents=True, exist_ok=True)
        super().emit(record)

    def doRollover(self) -> None:  # noqa: N802 - its name
        super().doRollover()
        self._num_bytes = 0

    def handleError(self, record: LogRecord) -> None:  # noqa: N802 - its name
        # The stream keeps what it could not write, and would fail with it again and again.
        with contextlib.suppress(OSError):
            self.close()
        with contextlib.suppress(OSError):
            os.truncate(self.baseFilename, self._num_bytes)
