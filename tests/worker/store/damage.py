"""Damages of a SQLite file, as disks, crashes and copies make them."""

import contextlib
import os
import shutil
from collections.abc import Callable
from pathlib import Path

from worker.store.store import JobStore

PAGE_BYTES = 4096


def overwrite(path: Path, offset: int, content: bytes) -> None:
    with path.open("r+b") as file:
        file.seek(offset)
        file.write(content)


def middle(path: Path) -> int:
    """Offset of a page in the middle."""
    return path.stat().st_size // PAGE_BYTES // 2 * PAGE_BYTES


def invert_page(path: Path, offset: int) -> None:
    content = path.read_bytes()[offset : offset + PAGE_BYTES]
    overwrite(path, offset, bytes(byte ^ 255 for byte in content))


def damage_under(path: Path) -> None:
    """Overwrite all pages except the first with zeros, and make all processes that have the file open read it anew."""
    with contextlib.closing(JobStore(f"sqlite:///{path}")) as other:
        other.webhook_secrets.rotate("studio", 0.0)
        with other._database.reading() as connection:
            connection.exec_driver_sql("PRAGMA wal_checkpoint(TRUNCATE)")
    overwrite(path, PAGE_BYTES, bytes(path.stat().st_size - PAGE_BYTES))


DAMAGES: dict[str, Callable[[Path], None]] = {
    "zeros in the middle": lambda path: overwrite(path, middle(path), bytes(8 * PAGE_BYTES)),
    "a page inverted": lambda path: invert_page(path, middle(path)),
    "truncated": lambda path: os.truncate(path, middle(path)),
    "truncated within a page": lambda path: os.truncate(path, middle(path) + 777),
    "truncated to nothing": lambda path: os.truncate(path, 0),
    "no header": lambda path: overwrite(path, 0, bytes(100)),
    "first page random": lambda path: overwrite(path, 0, os.urandom(PAGE_BYTES)),
    "another file": lambda path: overwrite(path, 0, b"%PDF-1.7\n" * 1000),
}


def copy_of(folder: Path, target: Path) -> Path:
    """A copy of a stopped service's data; returns its database."""
    shutil.copytree(folder, target)
    return target / "multicap.db"
