"""Worker processes end chunks that hang in a call which keeps Python's lock: no thread of theirs can run."""

import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from worker.run.tasks import machine_memory_bytes

PROGRAM = """
import ctypes, types
from worker.run import chunk, tasks

chunk._SHORTEST_LIMIT_S = chunk._UNIT_S = tasks.STOP_GRACE_S = 0.1

def hanging(work):
    ctypes.PyDLL(None).sleep(30)  # keeps the lock

def quick(work):
    return "done"

work = types.SimpleNamespace(claim=types.SimpleNamespace(unit_count=1))
print(tasks._watched(quick, 1.0)(work), flush=True)
tasks._watched(hanging, 1.0)(work)
print("not reached", flush=True)
"""


def test_chunk_that_keeps_lock_ends_its_process_and_says_where() -> None:
    ended = subprocess.run([sys.executable, "-P", "-c", PROGRAM], capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stdout) == (1, "done\n")
    assert "in hanging" in ended.stderr


GIB = 2**30


@pytest.mark.parametrize(
    ("limits", "expected"),
    [
        ({"": "max"}, None),
        ({"jobs": f"{GIB}\n"}, GIB),
        ({"": f"{2 * GIB}\n", "jobs": "max\n"}, 2 * GIB),
        ({"jobs": f"{3 * GIB}", "jobs/worker": f"{4 * GIB}"}, 3 * GIB),
    ],
)
def test_least_limit_of_all_groups_holds(tmp_path: Path, limits: dict[str, str], expected: int | None) -> None:
    groups, process_group = tmp_path / "cgroup", tmp_path / "process_group"
    (groups / "jobs" / "worker").mkdir(parents=True)
    for name, limit in limits.items():
        (groups / name / "memory.max").write_text(limit)
    process_group.write_text("0::/jobs/worker\n")
    whole = psutil.virtual_memory().total if expected is None else expected
    assert machine_memory_bytes(groups, process_group) == int(0.9 * whole)


def test_without_cgroups_machine_counts(tmp_path: Path) -> None:
    missing = tmp_path / "missing"
    assert machine_memory_bytes(missing, missing) == int(0.9 * psutil.virtual_memory().total)
