import subprocess
import sys

import pytest

# Pictures come and go while small things between them stay.
PROGRAM = """
import gc, psutil, sys
import numpy as np
from pipeline.core.runtime.resources import give_pictures_back

if sys.argv[1] == "given back":
    give_pictures_back()
kept = []
for _ in range(2):
    pictures = []
    for _ in range(20):
        pictures.append(np.ones(6_000_000, np.uint8))
        kept.append(bytearray(100_000))
    del pictures
print(psutil.Process().memory_info().rss)
"""


def resident_bytes(mode: str) -> int:
    command = [sys.executable, "-c", PROGRAM, mode]
    return int(subprocess.run(command, capture_output=True, text=True, check=True, timeout=180).stdout)


@pytest.mark.skipif(sys.platform != "linux", reason="an allocator of other systems")
def test_pictures_that_were_freed_take_no_memory() -> None:
    assert resident_bytes("kept") - resident_bytes("given back") > 60_000_000


@pytest.mark.skipif(sys.platform != "linux", reason="other systems count other memory")
def test_allocations_beyond_limit_fail() -> None:
    program = (
        "import numpy as np, psutil\n"
        "from pipeline.core.runtime.resources import limit_memory\n"
        "limit_memory(2**30)\n"
        "limit_memory(2**31)\n"
        "np.ones(2**25)\n"
        "try:\n"
        "    np.ones(2**28)\n"
        "except MemoryError:\n"
        "    print(psutil.Process().memory_info().rss)\n"
    )
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=180)
    assert int(ended.stdout) < 2**30


RAISE = "from pipeline.core.runtime.resources import raise_descriptor_limit\nprint(raise_descriptor_limit())\n"
OF_CHILD = "import subprocess, sys; subprocess.run(['sh', '-c', 'ulimit -Sn'])\n"


def run(limits: str, code: str) -> list[int]:
    command = ["prlimit", f"--nofile={limits}", sys.executable, "-c", code]
    return [int(word) for word in subprocess.run(command, capture_output=True, check=True, timeout=180).stdout.split()]


def test_descriptor_limit_is_raised_for_children_too() -> None:
    assert run("100:1500", "print(flush=True)\n" + OF_CHILD) == [100]
    assert run("100:1500", RAISE + "import sys; sys.stdout.flush()\n" + OF_CHILD) == [1500, 1500]


def test_mapped_files_may_be_more_than_first_limit_of_descriptors() -> None:
    program = "from pipeline.core.runtime.resources import map_file\nprint(len([map_file(1) for _ in range(150)]))"
    assert run("100:1500", program) == [150]


def test_limit_that_is_high_already_stays() -> None:
    assert run("1500:1500", RAISE) == [1500]


def test_loading_modules_collects_no_garbage() -> None:
    """With Python's own thresholds, garbage is collected some 130 times while these modules are loaded."""
    program = "import gc; from pipeline.core.runtime.resources import collect_seldom; collect_seldom()\n"
    program += "import numba; print(sum(generation['collections'] for generation in gc.get_stats()))"
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=180)
    assert int(ended.stdout) < 40
