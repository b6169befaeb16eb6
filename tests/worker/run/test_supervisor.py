"""Supervisor with small programs: restarts, order of stopping, and no process that outlives it."""

import json
import os
import shutil
import signal
import subprocess
import sys
import textwrap
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import psutil
import pytest

from tests.small_disk import small_disk
from tests.waiting import wait_for
from worker.run.supervisor import NUM_OLD_FILES, LogFile, Program, Supervisor


def program(name: str, code: str, stop_s: float = 5.0) -> Program:
    return Program(name, [sys.executable, "-c", textwrap.dedent(code)], dict(os.environ), stop_s=stop_s)


def run_until(condition: Callable[[], bool], supervisor: Supervisor, timeout_s: float = 15.0) -> None:
    """Run the supervisor until a condition holds, then interrupt it."""
    held = []

    def watch() -> None:
        deadline_s = time.monotonic() + timeout_s
        while not (condition() or time.monotonic() > deadline_s):
            time.sleep(0.05)
        held.append(condition())
        os.kill(os.getpid(), signal.SIGINT)

    watching = threading.Thread(target=watch)
    watching.start()
    supervisor.run()
    watching.join()
    assert held == [True], "nothing happened in time"


def test_crashed_program_starts_later_each_time_with_warning(tmp_path: Path) -> None:
    starts = tmp_path / "starts"
    crashing = program("worker", f"open({str(starts)!r}, 'a').write('x'); import os; os.kill(os.getpid(), 9)")
    said: list[str] = []
    run_until(lambda: len(said) == 3, Supervisor([crashing], tmp_path, said.append))
    assert said == [
        f"The worker was killed by SIGKILL; it starts again in {delay} s. See worker.log."
        for delay in ("0.5", "1", "2")
    ]
    assert starts.read_text() == "xxx"


def test_programs_stop_at_once_but_needed_ones(tmp_path: Path) -> None:
    code = """
        import pathlib, signal, sys, time
        folder = pathlib.Path({folder!r})
        def stop(*_):
            if {name!r} != "broker":
                (folder / ({name!r} + " stops")).touch()
                while len(list(folder.glob("* stops"))) < 2: time.sleep(0.01)
            with (folder / "order").open("a") as file: file.write({name!r} + " ")
            sys.exit()
        signal.signal(signal.SIGTERM, stop)
        (folder / {name!r}).touch()
        while True: signal.pause()
    """
    names = ["broker", "worker", "api"]
    programs = [program(name, textwrap.dedent(code).format(folder=str(tmp_path), name=name)) for name in names]
    programs[0] = replace(programs[0], stops_last=True)
    said: list[str] = []
    supervisor = Supervisor(programs, tmp_path / "logs", said.append)
    run_until(lambda: all((tmp_path / name).exists() for name in names), supervisor)
    order = (tmp_path / "order").read_text().split()
    assert (sorted(order[:2]), order[2:]) == (["api", "worker"], ["broker"])
    assert said == []


def test_program_that_does_not_stop_is_killed_with_its_children(tmp_path: Path) -> None:
    stubborn = program(
        "worker",
        f"""
        import os, pathlib, signal, time
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        child = os.fork()
        if child: pathlib.Path({str(tmp_path)!r}, "pids").write_text(f"{{os.getpid()}} {{child}}")
        time.sleep(600)
        """,
        stop_s=0.3,
    )
    said: list[str] = []
    pids = tmp_path / "pids"
    supervisor = Supervisor([stubborn], tmp_path / "logs", said.append)
    run_until(lambda: pids.exists() and len(pids.read_text().split()) == 2, supervisor)
    assert said == ["The worker did not end in 0.3 s and is killed."]
    wait_for(lambda: not any(is_alive(int(pid)) for pid in pids.read_text().split()))


def test_output_goes_to_log(tmp_path: Path) -> None:
    said: list[str] = []
    speaking = program("api", "import sys; print('hello', flush=True); print('trouble', file=sys.stderr); sys.exit(3)")
    run_until(lambda: bool(said), Supervisor([speaking], tmp_path, said.append))
    assert said == ["The api ended with exit code 3; it starts again in 0.5 s. See api.log."]
    lines = [json.loads(line) for line in (tmp_path / "api.log").read_text().splitlines()]
    assert [line["event"] for line in lines] == ["hello", "trouble"]


@pytest.mark.skipif(sys.platform != "linux", reason="needs Linux: children can't be tied to their parent")
def test_children_die_with_killed_supervisor(tmp_path: Path) -> None:
    code = f"""
        import os, pathlib, sys
        from worker.run.supervisor import Program, Supervisor
        sleeping = "import pathlib, os, sys, time; pathlib.Path(sys.argv[1], str(os.getpid())).touch(); time.sleep(600)"
        programs = [Program(n, [sys.executable, "-c", sleeping, {str(tmp_path)!r}], dict(os.environ)) for n in "ab"]
        Supervisor(programs, pathlib.Path({str(tmp_path)!r}, "logs"), print).run()
    """
    supervisor = subprocess.Popen([sys.executable, "-c", textwrap.dedent(code)])
    try:
        wait_for(lambda: len(pids(tmp_path)) == 2)
        assert all(is_alive(pid) for pid in pids(tmp_path))
    finally:
        supervisor.kill()
        supervisor.wait()
    wait_for(lambda: not any(is_alive(pid) for pid in pids(tmp_path)), timeout_s=120)


def pids(folder: Path) -> list[int]:
    return [int(path.name) for path in folder.iterdir() if path.name.isdigit()]


def is_alive(pid: int) -> bool:
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def write(log: LogFile, content: bytes) -> None:
    """Write through a pipe, as the output of a program."""
    reading, writing = os.pipe()
    log.follow(os.fdopen(reading, "rb"))
    with os.fdopen(writing, "wb") as pipe:
        pipe.write(content)
    log.close()


def test_line_that_is_no_json_becomes_event_of_one(tmp_path: Path) -> None:
    path = tmp_path / "logs" / "worker.log"
    write(LogFile(path), b'{"event": "chunk_done"}\n\nworker: Warm shutdown\n\xff{\n')
    lines = path.read_text(encoding="utf-8").splitlines()
    assert lines[0] == '{"event": "chunk_done"}'
    assert [json.loads(line)["event"] for line in lines] == ["chunk_done", "worker: Warm shutdown", "\\xff{"]
    assert all(json.loads(line)["timestamp"].endswith("Z") for line in lines[1:])


def test_parts_are_rotated_while_program_writes(tmp_path: Path) -> None:
    path = tmp_path / "api.log"
    lines = [json.dumps({"event": "request", "number": number, "path": "x" * 900}) for number in range(100)]
    write(LogFile(path, max_bytes=10_000), "\n".join(lines).encode())
    parts = sorted(tmp_path.iterdir(), key=lambda part: -int(part.suffix.removeprefix(".").replace("log", "0")))
    assert [part.name for part in parts] == [f"api.log.{n}" for n in range(NUM_OLD_FILES, 0, -1)] + ["api.log"]
    assert all(part.stat().st_size <= 10_000 for part in parts)
    kept = "".join(part.read_text() for part in parts).splitlines()
    assert kept == lines[-len(kept) :]
    assert len(kept) > 40


def test_lines_are_lost_only_while_disk_is_full(tmp_path: Path) -> None:
    with small_disk(tmp_path / "disk", 1) as disk:
        filler = disk / "filler"
        filler.write_bytes(bytes(2**20 - 64 * 2**10))
        log = LogFile(disk / "api.log")
        write(log, b'{"event": "lost"}\n' * 10_000)
        filler.unlink()
        write(log, b'{"event": "kept"}\n')
        events = [json.loads(line)["event"] for line in (disk / "api.log").read_text().splitlines()]
        assert (events[0], events[-1]) == ("lost", "kept")
        assert len(events) < 10_000


def test_removed_log_is_created_again(tmp_path: Path) -> None:
    path = tmp_path / "logs" / "api.log"
    log = LogFile(path)
    reading, writing = os.pipe()
    log.follow(os.fdopen(reading, "rb"))
    with os.fdopen(writing, "wb", buffering=0) as pipe:
        pipe.write(b'{"event": "before"}\n')
        wait_for(path.exists)
        shutil.rmtree(path.parent)
        pipe.write(b'{"event": "after"}\n')
    log.close()
    assert path.read_text() == '{"event": "after"}\n'
