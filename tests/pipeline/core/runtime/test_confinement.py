"""Confined programs: limits, output, and the errors of each kind of end."""

import errno
import json
import os
import signal
import textwrap
from pathlib import Path
from typing import Any

import pytest

from pipeline.core.errors import ChildError, Problem
from pipeline.core.problems.request_codes import SESSION_TOO_LARGE
from pipeline.core.runtime import child_processes, confinement
from pipeline.core.runtime.confinement import BeyondLimitsError, ChildLimits, FileRefusedError, run_confined

LIMITS = ChildLimits(cpu_s=20, memory_bytes=2**30, file_bytes=1000, open_files=16)


def run(monkeypatch: pytest.MonkeyPatch, act: str, limits: ChildLimits = LIMITS, timeout_s: float = 60.0) -> bytes:
    """Run a program that acts when it is ready."""
    program = f"""
        import os, resource, signal, sys, time
        from pipeline.core.runtime.confinement import confined_arguments, tell_ready
        sys.argv[:1] = ["program"]
        (word,) = confined_arguments()
        print("a library says hello", flush=True)
        tell_ready()
        {act}
        """
    command = child_processes.python_command("-c", textwrap.dedent(program))
    monkeypatch.setattr(confinement, "module_command", lambda _, *arguments: [*command, *arguments])
    monkeypatch.chdir(Path(__file__).parents[4])
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[4]), prepend=os.pathsep)
    return run_confined("a.program", ["word"], limits, task="check of a.mp4", timeout_s=timeout_s, given=b"given")


def test_output_after_ready_is_returned(monkeypatch: pytest.MonkeyPatch) -> None:
    assert run(monkeypatch, "print(word, sys.stdin.read() * 50_000, end='')") == b"word " + 50_000 * b"given"


def test_limits_are_set_in_program(monkeypatch: pytest.MonkeyPatch) -> None:
    names = "AS CPU FSIZE NOFILE CORE"
    act = f"print([resource.getrlimit(getattr(resource, 'RLIMIT_' + name))[0] for name in {names!r}.split()])"
    assert run(monkeypatch, act) == f"[{2**30}, 20, 1000, 16, 0]\n".encode()


@pytest.mark.parametrize(
    ("act", "limits", "timeout_s", "is_time"),
    [
        ("os.kill(os.getpid(), signal.SIGSEGV)", LIMITS, 60.0, False),
        ("sys.exit(4)", LIMITS, 60.0, False),
        ("while True: pass", LIMITS._replace(cpu_s=1), 60.0, True),
        ("time.sleep(60)", LIMITS, 5.0, True),
    ],
)
def test_limit_of_file_raises_beyond_limits(
    monkeypatch: pytest.MonkeyPatch, act: str, limits: ChildLimits, timeout_s: float, is_time: bool
) -> None:
    with pytest.raises(BeyondLimitsError) as error:
        run(monkeypatch, act, limits, timeout_s)
    assert error.value.is_time == is_time


def test_refused_file_raises_with_its_text(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(FileRefusedError, match=r"^no frames$"):
        run(monkeypatch, "sys.stderr.write('no frames'); sys.exit(3)")


@pytest.mark.parametrize(
    ("act", "words"),
    [
        (f"os.kill(os.getpid(), {int(signal.SIGKILL)})", "it was ended by SIGKILL"),
        ("import no_such_module", r"it ended with exit code 1 \(ModuleNotFoundError"),
    ],
)
def test_other_end_is_not_fault_of_file(monkeypatch: pytest.MonkeyPatch, act: str, words: str) -> None:
    with pytest.raises(ChildError, match=f"check of a.mp4 failed, the file is not at fault: {words}"):
        run(monkeypatch, act)


@pytest.mark.parametrize(
    ("error", "exit_code", "codes"),
    [
        (MemoryError(), 2, ["session_too_large"]),
        (OSError(errno.EFBIG, "File too large"), 2, ["session_too_large"]),
        (OSError(errno.ENOSPC, "No space left on device"), 4, None),
    ],
    ids=["memory", "file size", "full disk"],
)
def test_check_beyond_its_limits_answers_a_problem(
    error: Exception, exit_code: int, codes: list[str] | None, capsys: pytest.CaptureFixture[str]
) -> None:
    def check() -> dict[str, Any]:
        raise error

    assert confinement.print_answer(check, Problem(SESSION_TOO_LARGE, "It is too large.")) == exit_code
    output = capsys.readouterr().out
    assert (output and [problem["code"] for problem in json.loads(output)["problems"]]) == (codes or "")
