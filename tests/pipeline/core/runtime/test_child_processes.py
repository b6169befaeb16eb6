import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import psutil
import pytest

from pipeline.core.runtime.child_processes import ProcessPool, module_command
from tests.cases import slow_but

# Two processes that have work for a minute.
PROGRAM = """
    import time
    from pipeline.core.runtime.child_processes import ProcessPool
    if __name__ == "__main__":
        with ProcessPool(2) as pool:
            waiting = [pool.submit(time.sleep, 60) for _ in range(2)]
            list(pool.map(abs, []))
            print("working", flush=True)
            waiting[0].result()
"""


def blocks(process: psutil.Process, number: int) -> bool:
    status = Path(f"/proc/{process.pid}/status").read_text(encoding="ascii")
    return bool(int(status.partition("SigBlk:")[2].split()[0], 16) >> (number - 1) & 1)


def workers_of(process: "subprocess.Popen[str]", number: int) -> list[psutil.Process]:
    """Wait for the pool's processes: the command line of one that was started just now is still empty."""
    end_s = time.monotonic() + 10
    workers: list[psutil.Process] = []
    while len(workers) != number and time.monotonic() < end_s:
        children = psutil.Process(process.pid).children()
        workers = [one for one in children if "--multiprocessing-fork" in one.cmdline()]
    return workers


@pytest.mark.parametrize("number", slow_but([signal.SIGKILL], [signal.SIGINT, signal.SIGKILL]))
def test_processes_end_with_block_or_their_parent(tmp_path: Path, number: signal.Signals) -> None:
    program = tmp_path / "program.py"
    program.write_text(textwrap.dedent(PROGRAM), encoding="utf-8")
    with subprocess.Popen([sys.executable, str(program)], stdout=subprocess.PIPE, text=True, stderr=-1) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "working\n"
        workers = workers_of(process, 2)
        assert len(workers) == 2
        # As a terminal's Ctrl-C, which every process of the group gets, in the middle of its start.
        assert all(blocks(one, signal.SIGINT) for one in workers)
        for one in workers:
            one.send_signal(signal.SIGINT)
        time.sleep(3)  # until both have started and work
        assert all(one.is_running() for one in workers)
        asked_s = time.monotonic()
        process.send_signal(number)
        process.wait(10)
        gone, alive = psutil.wait_procs(workers, timeout=5)
        assert (len(gone), alive) == (2, [])
        assert time.monotonic() - asked_s < 10
        assert process.stderr is not None
        assert "SpawnProcess" not in process.stderr.read()


def test_error_in_block_waits_for_nobody() -> None:
    started_s = time.monotonic()
    with pytest.raises(TimeoutError), ProcessPool(1) as pool:
        pool.submit(time.sleep, 60).result(timeout=1)
    assert time.monotonic() - started_s < 20


def test_pool_with_first_function_calls_it_and_works() -> None:
    with ProcessPool(2, os.nice, [1]) as pool:
        assert list(pool.map(abs, [-1, -2, -3])) == [1, 2, 3]
        assert pool.submit(os.nice, 0).result() == os.nice(0) + 1


def test_child_processes_need_standard_library_only() -> None:
    """The web API's settings and the jobs' contract import the module, but no third-party packages."""
    text = (
        "import sys; before = set(sys.modules); import pipeline.core.runtime.child_processes; "
        "print(*{name.partition('.')[0] for name in set(sys.modules) - before} - sys.stdlib_module_names)"
    )
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=True)
    assert set(done.stdout.split()) - {"__mp_main__"} == {"pipeline"}


def test_module_s_command() -> None:
    assert module_command("pipeline.capture.preflight", "--units", "mm")[1:] == [
        "-P",
        "-m",
        "pipeline.capture.preflight",
        "--units",
        "mm",
    ]
