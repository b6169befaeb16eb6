"""Ends of the child process that examines a video: faults of the file or of Multicap."""

import os
import signal
import subprocess
import threading
import time
from pathlib import Path
from typing import Any

import psutil
import pytest

from pipeline.core.errors import ChildError, Problem
from pipeline.core.runtime.child_processes import python_command
from pipeline.video import probe_process as probing
from pipeline.video.info import VideoInfo
from pipeline.video.probe_process import probe_in_children
from tests.pipeline.media import write_video
from tests.pipeline.video.children import in_children, when_opened
from tests.waiting import wait_for


@pytest.mark.parametrize("module", ["probe", "decode_process", "sound", "playback.proxy"])
def test_child_imports_little(module: str) -> None:
    program = f"import sys, pipeline.video.{module}; print(*{{name.partition('.')[0] for name in sys.modules}})"
    done = subprocess.run(python_command("-c", program), capture_output=True, text=True, check=True)
    assert {"av", "pipeline"} <= set(done.stdout.split())
    heavy = {"jaxtyping", "scipy", "cv2", "onnxruntime"} | (
        {"numpy"} if module in {"decode_process", "playback.proxy"} else set()
    )
    assert not heavy & set(done.stdout.split())


@pytest.mark.parametrize("number", [signal.SIGSEGV, signal.SIGABRT, signal.SIGXCPU, signal.SIGFPE])
def test_file_that_kills_its_decoder_is_bad_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: signal.Signals
) -> None:
    in_children(tmp_path, monkeypatch, when_opened(f"os.kill(os.getpid(), {int(number)})"))
    (found,) = probe_in_children([write_video(tmp_path / "a.mp4", 3)])
    assert isinstance(found, Problem)
    assert (found.code, found.file) == ("video_unreadable", "a.mp4")


@pytest.mark.parametrize(
    "act", ["raise MemoryError", "time.sleep(60)", pytest.param("\n    while True: pass", marks=pytest.mark.slow)]
)
def test_file_beyond_limits_is_bad_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, act: str) -> None:
    monkeypatch.setattr(probing, "_TIMEOUT_S", 6.0)
    in_children(tmp_path, monkeypatch, when_opened(act))
    (found,) = probe_in_children([write_video(tmp_path / "a.mp4", 3)])
    assert isinstance(found, Problem)
    assert "limits" in found.message


def test_limit_on_computing_is_file_s(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The kernel ends the child by SIGXCPU, not by SIGKILL, which could have other causes."""
    limit = "import resource\nset_limit = resource.setrlimit\n"
    short = "resource.setrlimit = lambda kind, to: set_limit(kind, (2, 4) if kind == resource.RLIMIT_CPU else to)\n"
    in_children(tmp_path, monkeypatch, limit + short + when_opened("\n    while True: pass"))
    (found,) = probe_in_children([write_video(tmp_path / "a.mp4", 3)])
    assert isinstance(found, Problem)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("import sys\nsys.modules['av'] = None\n", "'av' is not a package"),
        (when_opened("os.kill(os.getpid(), signal.SIGKILL)"), "SIGKILL"),
        (when_opened("os.kill(os.getpid(), signal.SIGTERM)"), "SIGTERM"),
        ("import os, sys\nif 'pipeline.video.probe' in sys.orig_argv: os.kill(os.getpid(), 11)\n", "SIGSEGV"),
        (when_opened("raise AttributeError('a mistake of ours')"), "a mistake of ours"),
    ],
)
def test_child_that_fails_by_itself_is_not_file_s_fault(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, words: str
) -> None:
    in_children(tmp_path, monkeypatch, text)
    with pytest.raises(ChildError, match="not at fault") as raised:
        probe_in_children([write_video(tmp_path / "a.mp4", 3), write_video(tmp_path / "b.mp4", 3)])
    assert words in str(raised.value)
    assert "check of a.mp4" in str(raised.value) or "check of b.mp4" in str(raised.value)
    assert "Traceback" not in str(raised.value)
    assert "stderr" in raised.value.__notes__[0]


def is_probe(process: psutil.Process) -> bool:
    try:
        return "pipeline.video.probe" in process.cmdline()
    except psutil.Error:  # it has ended
        return False


def probes() -> list[psutil.Process]:
    return [child for child in psutil.Process().children(recursive=True) if is_probe(child)]


def test_interruption_leaves_no_child(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    in_children(tmp_path, monkeypatch, when_opened("time.sleep(60)"))
    paths = [write_video(tmp_path / f"{k}.mp4", 3) for k in range(4)]

    def interrupt() -> None:
        # Other tests may have left children: an interruption before the call would end the tests.
        while len(probes()) < 3:  # the program and two files at a time
            time.sleep(0.05)
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=interrupt, daemon=True).start()
    started_s = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        probe_in_children(paths)
    assert time.monotonic() - started_s < 20
    assert not probes()


def test_interruption_while_children_start_leaves_no_child(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    in_children(tmp_path, monkeypatch, when_opened("time.sleep(60)"))

    class Interrupted(subprocess.Popen[bytes]):
        def __init__(self, *arguments: Any, **named: Any) -> None:
            super().__init__(*arguments, **named)
            os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr("pipeline.core.runtime.confinement.subprocess.Popen", Interrupted)
    started_s = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        probe_in_children([write_video(tmp_path / f"{k}.mp4", 3) for k in range(4)])
    assert time.monotonic() - started_s < 20
    assert not probes()


def test_children_end_with_their_killed_parent(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    in_children(tmp_path, monkeypatch, when_opened("time.sleep(60)"))
    path = write_video(tmp_path / "a.mp4", 3)
    program = f"""
from pathlib import Path
from pipeline.video.probe_process import probe_in_children
probe_in_children([Path({str(path)!r})] * 2)
"""
    with subprocess.Popen(python_command("-c", program), cwd=Path(__file__).parents[3]) as parent:
        wait_for(lambda: len(list(filter(is_probe, psutil.Process(parent.pid).children(recursive=True)))) == 3)
        children = psutil.Process(parent.pid).children(recursive=True)
        assert {child.num_threads() for child in children} == {1}  # a process that forks must have one thread
        parent.kill()
    _, alive = psutil.wait_procs(children, timeout=10)
    assert alive == []


def test_failure_of_ours_ends_others_and_keeps_no_result(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    act = "os.kill(os.getpid(), signal.SIGKILL) if 'b.mp4' in a[0] else time.sleep(60)"
    in_children(tmp_path, monkeypatch, when_opened(act))
    started_s = time.monotonic()
    with pytest.raises(ChildError, match=r"check of b\.mp4"):
        probe_in_children([write_video(tmp_path / name, 3) for name in ("a.mp4", "b.mp4")])
    assert time.monotonic() - started_s < 30
    assert not probes()


def test_good_files_are_told(tmp_path: Path) -> None:
    found = probe_in_children([write_video(tmp_path / f"{k}.mp4", 3 + k) for k in range(3)])
    assert [video.num_frames for video in found if isinstance(video, VideoInfo)] == [3, 4, 5]
