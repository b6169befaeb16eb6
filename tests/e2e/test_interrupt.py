"""Interrupted `multicap reconstruct`: it reports the signal, and leaves neither processes nor incomplete files."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from pipeline.core.errors import ModelError
from pipeline.detection import models
from tests.e2e.captures import keypoint_capture, video_capture

COMMAND = [sys.executable, "-m", "api.cli.main", "reconstruct", "--no-cache"]

# In the command lines of its children: those that open videos or decode them, and those of a pool.
DECODING, POOL = "pipeline.video.", "multiprocessing-fork"

# Runs the command, and interrupts itself at the second call of ``{where}``.
AT = """
import os, signal, sys
import {module} as module
original, calls = module.{name}, []
def interrupted(*arguments):
    calls.append(1)
    if len(calls) == 2:
        os.kill(os.getpid(), signal.{signal})
    return original(*arguments)
module.{name} = interrupted
from api.cli.main import main
sys.argv = ["multicap", *sys.argv[1:]]
main()
"""


@pytest.fixture(scope="module")
def videos(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    try:
        models.verify("movenet-multipose")
    except ModelError:
        pytest.skip("the default detector is not installed")
    # At least a minute of work.
    return video_capture(tmp_path_factory.mktemp("capture"), num_frames=3000)


def wait_for_children(process: "subprocess.Popen[str]", word: str) -> list[psutil.Process]:
    deadline_s = time.monotonic() + 120
    while True:
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline_s
        children = psutil.Process(process.pid).children(recursive=True)
        with contextlib.suppress(psutil.NoSuchProcess):
            if any(word in " ".join(child.cmdline()) for child in children if child.status() != psutil.STATUS_ZOMBIE):
                return children
        time.sleep(0.05)


@pytest.mark.parametrize(
    ("number", "options", "word", "later_s"),
    [
        (signal.SIGINT, [], DECODING, 8.0),
        (signal.SIGTERM, ["--json"], DECODING, 0.0),
        (signal.SIGINT, ["--processes=2", "--json"], POOL, 0.0),
        (signal.SIGTERM, ["--processes=2"], POOL, 8.0),
    ],
)
def test_children_end_and_it_is_said(
    videos: list[str],
    tmp_path: Path,
    number: signal.Signals,
    options: list[str],
    word: str,
    later_s: float,
) -> None:
    out = tmp_path / "out"
    command = [*COMMAND, *videos, f"--out={out}", "--chunk-frames=50", *options]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        children = wait_for_children(process, word)
        time.sleep(later_s)
        children += psutil.Process(process.pid).children(recursive=True)
        asked_s = time.monotonic()
        if number == signal.SIGINT:
            os.killpg(process.pid, number)  # as a terminal does: to all processes of the group
        else:
            process.send_signal(number)
        said, errors = process.communicate(timeout=180)
        assert time.monotonic() - asked_s < 15
    assert process.returncode == 128 + number
    assert "Traceback" not in errors
    assert "Process" not in errors
    _, alive = psutil.wait_procs(children, timeout=5)
    assert alive == []
    if "--json" in options:
        (problem,) = json.loads(said)["problems"]
        assert problem == {"code": "interrupted", "message": f"Interrupted by {number.name}. No result was written."}
    else:
        assert said == ""
        assert f"Interrupted by {number.name}. No result was written." in errors
    assert not out.exists()


@pytest.mark.parametrize(("number", "as_json"), [(signal.SIGINT, False), (signal.SIGTERM, True)])
def test_while_files_are_written_none_is_left(tmp_path: Path, number: signal.Signals, as_json: bool) -> None:
    """All files of a take get their names when the last one is whole."""
    out = tmp_path / "out"
    program = AT.format(module="pipeline.export.writers.bvh", name="encode", signal=number.name)
    options = [*keypoint_capture(tmp_path / "capture"), f"--out={out}", *(["--json"] if as_json else [])]
    command = [sys.executable, "-c", program, "reconstruct", *options]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 128 + number, done.stderr
    assert "Traceback" not in done.stderr
    said = json.loads(done.stdout)["problems"][0]["message"] if as_json else done.stderr
    assert f"Interrupted by {number.name}. No result was written." in said
    assert not out.exists()


WHILE_LOADING = """
import os, signal, sys
class Finder:
    def find_spec(self, name, *_):
        if name == "api.cli.commands":
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Finder())
from api.cli.start import main
main()
"""


@pytest.mark.parametrize("options", [[], ["--json"]])
def test_while_libraries_are_loaded(options: list[str]) -> None:
    command = [sys.executable, "-c", WHILE_LOADING, "reconstruct", *options]
    done = subprocess.run(command, capture_output=True, text=True, timeout=180, check=False)
    assert done.returncode == 130
    assert "Traceback" not in done.stderr
    said = json.loads(done.stdout)["problems"][0]["message"] if options else done.stderr
    assert "Interrupted by SIGINT. Nothing was done." in said
