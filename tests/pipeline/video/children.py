"""Faults in the child processes that open videos, and search of such processes."""

import os
import time
from pathlib import Path

import psutil
import pytest

from pipeline.core.runtime import child_processes
from tests.warm_programs import PYTHON_COMMAND


def in_children(folder: Path, monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    """Run code at the start of each Python process that is started from now on; none is forked."""
    monkeypatch.setattr(child_processes, "python_command", PYTHON_COMMAND)
    (folder / "sitecustomize.py").write_text(text, encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(folder), prepend=os.pathsep)


def when_opened(act: str) -> str:
    """Source code that replaces the opening of a video by a statement."""
    return f"import os, signal, time, av\ndef act(*a, **k):\n    {act}\nav.open = act\n"


def children_of(module: str) -> list[psutil.Process]:
    """Children of this process that run a module and have not ended."""
    return [
        child
        for child in psutil.Process().children(recursive=True)
        if child.status() != psutil.STATUS_ZOMBIE and module in child.cmdline()
    ]


def wait_for_child(module: str) -> psutil.Process:
    """Wait for a child that runs a module."""
    deadline_s = time.monotonic() + 120
    while not (found := children_of(module)):
        assert time.monotonic() < deadline_s
        time.sleep(0.02)
    return found[0]
