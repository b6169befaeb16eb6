"""Worker processes end chunks that hang in a call which keeps Python's lock: no thread of theirs can run."""

import subprocess
import sys

PROGRAM = """
import ctypes, types
from worker import lease, tasks

lease._SHORTEST_LIMIT_S = lease._UNIT_S = tasks.STOP_GRACE_S = 0.1

def hanging(work):
    ctypes.PyDLL(None).sleep(30)  # keeps the lock

def quick(work):
    return "done"

work = types.SimpleNamespace(claim=types.SimpleNamespace(unit_count=1))
print(tasks._watched(quick, 1.0)(work), flush=True)
tasks._watched(hanging, 1.0)(work)
print("not reached", flush=True)
"""


def test_a_chunk_that_keeps_the_lock_ends_its_process_and_says_where() -> None:
    ended = subprocess.run([sys.executable, "-P", "-c", PROGRAM], capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stdout) == (1, "done\n")
    assert "in hanging" in ended.stderr
