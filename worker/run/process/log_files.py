"""Log files of programs: their output as one JSON object a line, rotated while they run."""

import contextlib
import json
import os
import threading
from datetime import UTC, datetime
from logging import LogRecord, makeLogRecord
from logging.handlers import RotatingFileHandler
from pathlib import Path
from typing import IO

# Size of one file; with its older parts a log takes at most five times as much.
MAX_FILE_BYTES = 16 * 2**20
NUM_OLD_FILES = 4
# A longer line is split.
_MAX_LINE_BYTES = 2**20
# Time to read the rest of a pipe whose writers have ended.
_REST_S = 1.0


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
