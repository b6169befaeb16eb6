"""Logs: every line is JSON, and a log that can't be written stops no work."""

import json
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any

import pytest

SPEAK = """
    import logging, sys, threading, warnings
    import structlog
    from worker.run.logs import configure_logs
    configure_logs(sys.argv[1])
    log = structlog.get_logger()
    log.debug("quiet")
    log.info("said", path="x" * 60_000)
    log.warning("heeded")
    logging.getLogger("library").warning("of %s", "a library")
    try:
        1 / 0
    except ZeroDivisionError:
        log.exception("failed")
        logging.getLogger("library").exception("failed, too")
    warnings.warn("a warning")
    thread = threading.Thread(target=lambda: 1 / 0)
    thread.start()
    thread.join()
    print("done")
    raise ValueError("the end")
"""


def speak(level: str, stderr: Any = subprocess.PIPE) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", textwrap.dedent(SPEAK), level]
    return subprocess.run(command, stdout=subprocess.PIPE, stderr=stderr, text=True, check=False)


def test_every_line_is_json_whoever_speaks() -> None:
    said = speak("info")
    lines = [json.loads(line) for line in said.stderr.splitlines()]
    events = [line["event"] for line in lines]
    assert events[:5] == ["said", "heeded", "of a library", "failed", "failed, too"]
    assert "UserWarning: a warning" in events[5]
    assert events[6:] == ["crashed", "crashed"]
    assert [line["level"] for line in lines] == ["info", *["warning"] * 2, *["error"] * 2, "warning", *["critical"] * 2]
    assert all("ZeroDivisionError" in lines[number]["exception"] for number in (3, 4, 6))
    assert "ValueError: the end" in lines[7]["exception"]
    assert len(lines[0]["path"]) < 5000
    assert said.stdout == "done\n"


@pytest.mark.parametrize(("level", "first"), [("debug", "quiet"), ("warning", "heeded"), ("error", "failed")])
def test_less_severe_events_are_left_out(level: str, first: str) -> None:
    assert json.loads(speak(level).stderr.splitlines()[0])["event"] == first


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_log_that_cannot_be_written_stops_no_work() -> None:
    with Path("/dev/full").open("w") as full:
        said = speak("info", full)
    assert said.stdout == "done\n"
    assert said.returncode == 1  # by the uncaught error
