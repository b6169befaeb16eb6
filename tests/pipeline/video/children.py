"""Make the child processes that open videos misbehave."""

import os
import time
from pathlib import Path

import psutil
import pytest


def in_children(folder: Path, monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    """Run some code in every Python that is started, before its own."""
    (folder / "sitecustomize.py").write_text(text, encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(folder), prepend=os.pathsep)


def when_opened(act: str) -> str:
    """Code that does something as soon as a video is opened, as a decoder might."""
    return f"import os, signal, time, av\ndef act(*a, **k):\n    {act}\nav.open = act\n"


def children_of(module: str) -> list[psutil.Process]:
    """Children of this process that run a module and have not ended."""
    return [
        one
        for one in psutil.Process().children(recursive=True)
        if one.status() != psutil.STATUS_ZOMBIE and module in one.cmdline()
    ]


def wait_for_child(module: str) -> psutil.Process:
    """Wait for a child that runs a module."""
    deadline_s = time.monotonic() + 60
    while not (found := children_of(module)):
        assert time.monotonic() < deadline_s
        time.sleep(0.02)
    return found[0]
