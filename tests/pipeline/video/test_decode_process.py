"""Ends of the process that decodes a range of frames: faults of the file, of Multicap, and cleanup."""

import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import psutil
import pytest

from pipeline.core.errors import ChildError, InputError, Problem
from pipeline.video import decode as decode_module
from pipeline.video.decode import decode
from pipeline.video.info import VideoInfo
from pipeline.video.probe import probe
from tests.pipeline.media import write_video
from tests.pipeline.video.children import children_of, in_children, wait_for_child, when_opened

DECODER = "pipeline.video.decode_process"


@pytest.fixture
def video(tmp_path: Path) -> VideoInfo:
    found = probe(write_video(tmp_path / "a.mp4", 30))
    assert isinstance(found, VideoInfo)
    return found


def when_decoded(act: str, packet: int = 8) -> str:
    """Source code that replaces the decoding of a packet in the middle by a statement."""
    return f"""
import os, signal, sys, time
if {DECODER!r} in sys.orig_argv:
    import av.container
    from pipeline.video import container
    def demux(opened, stream):
        for number, packet in enumerate(av.container.InputContainer.demux(opened, stream)):
            if number == {packet}:
                {act}
            yield packet
    class Opened:
        def __init__(self, opened): self._opened = opened
        def demux(self, stream): return demux(self._opened, stream)
        def __getattr__(self, name): return getattr(self._opened, name)
    decode = container._decode
    container._decode = lambda opened, stream, **wanted: decode(Opened(opened), stream, **wanted)
"""


def problem_of(video: VideoInfo) -> Problem:
    with pytest.raises(InputError) as raised:
        list(decode(video, 0, 30))
    (problem,) = raised.value.problems
    assert problem.file == "a.mp4"
    assert children_of(DECODER) == []
    return problem


@pytest.mark.parametrize("number", [signal.SIGSEGV, signal.SIGABRT, signal.SIGXCPU, signal.SIGFPE, signal.SIGBUS])
def test_file_that_kills_its_decoder_is_bad_file(
    video: VideoInfo, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: signal.Signals
) -> None:
    in_children(tmp_path, monkeypatch, when_decoded(f"os.kill(os.getpid(), {int(number)})"))
    problem = problem_of(video)
    assert problem.code == "video_unreadable"
    assert "limits" in problem.message


@pytest.mark.parametrize(
    "act",
    [
        "raise MemoryError",
        "bytearray(8 << 30)",
        "time.sleep(60)",
        pytest.param("while True: pass", marks=pytest.mark.slow),
    ],
)
def test_file_beyond_limits_is_bad_file(
    video: VideoInfo, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, act: str
) -> None:
    monkeypatch.setattr(decode_module, "_TIMEOUT_S", 6.0)
    in_children(tmp_path, monkeypatch, when_decoded(act))
    problem = problem_of(video)
    assert problem.code == "video_unreadable"
    assert "of 30 could not be decoded within the limits on time and memory" in problem.message


def test_limit_on_computing_is_file_s(video: VideoInfo, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The kernel ends the child by SIGXCPU, although each frame arrives in time."""
    limit = "import resource\nset_limit = resource.setrlimit\n"
    short = "resource.setrlimit = lambda kind, to: set_limit(kind, (2, 4) if kind == resource.RLIMIT_CPU else to)\n"
    in_children(tmp_path, monkeypatch, limit + short + when_decoded("while True: pass"))
    assert problem_of(video).code == "video_unreadable"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("import sys\nsys.modules['av'] = None\n", "import of av halted"),
        (when_decoded("os.kill(os.getpid(), signal.SIGKILL)"), "SIGKILL"),
        (when_decoded("os.kill(os.getpid(), signal.SIGTERM)"), "SIGTERM"),
        (f"import os, sys\nif {DECODER!r} in sys.orig_argv: os.kill(os.getpid(), 11)\n", "SIGSEGV"),
        (when_decoded("raise AttributeError('a mistake of ours')"), "a mistake of ours"),
    ],
)
def test_process_that_fails_by_itself_is_not_file_s_fault(
    video: VideoInfo, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, words: str
) -> None:
    in_children(tmp_path, monkeypatch, text)
    with pytest.raises(ChildError, match="not at fault") as raised:
        list(decode(video, 0, 30))
    assert words in str(raised.value)
    assert "decoder of a.mp4" in str(raised.value)
    assert "Traceback" not in str(raised.value)
    assert "stderr" in raised.value.__notes__[0]


LIMITED = """
dumps = resource.getrlimit(resource.RLIMIT_CORE)
files = []
try:
    while True: files.append(open(os.devnull))
except OSError as error:
    opened, files = len(files), []
try:
    while True: os.write(2, b"x" * 2**16)
except OSError as error:
    open(os.environ["FOUND"], "w").write(f"{dumps} {opened} {os.fstat(2).st_size}")
    os.abort()
"""


def test_decoder_writes_no_core_dump_and_short_log(
    video: VideoInfo, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FOUND", str(tmp_path / "found"))
    in_children(tmp_path, monkeypatch, when_decoded(f"import resource; exec({LIMITED!r})"))
    assert problem_of(video).code == "video_unreadable"
    found = re.fullmatch(r"\(0, 0\) (\d+) 1048576", (tmp_path / "found").read_text())
    assert found is not None
    assert int(found[1]) < 64


def test_limited_decoder_that_really_crashes_is_bad_file(
    video: VideoInfo, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A null pointer in native code, as in a decoder's error."""
    in_children(tmp_path, monkeypatch, when_decoded("import ctypes; ctypes.string_at(0)"))
    assert problem_of(video).code == "video_unreadable"
    in_children(tmp_path, monkeypatch, when_decoded("import ctypes; ctypes.CDLL(None).abort()"))
    assert problem_of(video).code == "video_unreadable"


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_process_that_somebody_ends_is_not_file_s_fault(video: VideoInfo, number: signal.Signals) -> None:
    frames = decode(video, 0, 30)
    next(frames)
    wait_for_child(DECODER).send_signal(number)
    with pytest.raises(ChildError, match=number.name):
        list(frames)


def test_iterator_that_is_closed_leaves_no_process(video: VideoInfo) -> None:
    frames = decode(video, 0, 30)
    next(frames)
    assert len(children_of(DECODER)) == 1
    frames.close()
    assert children_of(DECODER) == []


def test_interruption_leaves_no_process(video: VideoInfo, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    in_children(tmp_path, monkeypatch, when_opened("time.sleep(60)"))

    def interrupt() -> None:
        wait_for_child(DECODER)
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=interrupt, daemon=True).start()
    started_s = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        list(decode(video, 0, 30))
    assert time.monotonic() - started_s < 30
    assert children_of(DECODER) == []


KILLED = """
import os, signal, sys
from pathlib import Path
from pipeline.video.decode import decode
from pipeline.video.probe import probe
frames = decode(probe(Path(sys.argv[1])), 0, 30)
next(frames)
print("decoding", flush=True)
sys.stdin.read()
"""


@pytest.mark.parametrize("text", ["", when_decoded("time.sleep(600)", packet=16)])
def test_process_ends_with_parent_that_was_killed(
    video: VideoInfo, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str
) -> None:
    in_children(tmp_path, monkeypatch, text)
    command = [sys.executable, "-c", KILLED, str(video.path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        assert parent.stdout.readline() == "decoding\n"
        (child,) = psutil.Process(parent.pid).children()
        parent.kill()
    _, alive = psutil.wait_procs([child], timeout=20)
    assert alive == []
