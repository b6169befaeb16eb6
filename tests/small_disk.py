"""Small disks for tests, if this machine allows mounting them."""

import contextlib
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest


@contextlib.contextmanager
def small_disk(folder: Path, num_mib: int, num_inodes: int | None = None) -> Iterator[Path]:
    """Mount a disk at a folder during the block; skip the test without the right to mount."""
    folder.mkdir(exist_ok=True)
    options = f"size={num_mib}m" + ("" if num_inodes is None else f",nr_inodes={num_inodes}")
    command = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)]
    if subprocess.run(command, check=False, capture_output=True).returncode != 0:
        pytest.skip("this machine lets nobody mount a small disk")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "--lazy", folder], check=True)


def fill(path: Path) -> None:
    """Write a file until the disk is full to the last byte."""
    for num_bytes in (2**20, 4096, 1):
        with contextlib.suppress(OSError), path.open("ab", buffering=0) as file:
            while True:
                file.write(bytes(num_bytes))
