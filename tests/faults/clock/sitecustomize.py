"""Offset of the clocks of Python and SQLite, in processes with this folder on their path; a file has the offset.

The monotonic clock is unchanged, as when a machine's clock is set. The C library's functions can't be replaced
from here, and packages that do it (libfaketime) break Python's sleep.
"""

import os
import sqlite3
import time
from pathlib import Path
from typing import Any

_OFFSET = Path(os.environ["MULTICAP_TEST_CLOCK"])

_real_time, _real_connect = time.time, sqlite3.connect


def _time() -> float:
    return _real_time() + float(_OFFSET.read_text())


def _julianday(moment: str) -> float:
    if moment != "now":
        raise ValueError(moment)
    return _time() / 86_400.0 + 2_440_587.5


def _connect(*arguments: Any, **options: Any) -> sqlite3.Connection:
    connection = _real_connect(*arguments, **options)
    connection.create_function("julianday", 1, _julianday)
    return connection


time.time = _time
time.time_ns = lambda: int(_time() * 1e9)
for module in (sqlite3, sqlite3.dbapi2):
    setattr(module, "connect", _connect)  # noqa: B010 - its type is an overload
