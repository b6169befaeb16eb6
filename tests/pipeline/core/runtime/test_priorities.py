"""Limit on open files of a process and its children."""

import subprocess
import sys

RAISE = "from pipeline.core.runtime.priorities import raise_descriptor_limit\nprint(raise_descriptor_limit())\n"
OF_CHILD = "import subprocess, sys; subprocess.run(['sh', '-c', 'ulimit -Sn'])\n"


def run(limits: str, code: str) -> list[int]:
    command = ["prlimit", f"--nofile={limits}", sys.executable, "-c", code]
    return [int(word) for word in subprocess.run(command, capture_output=True, check=True, timeout=180).stdout.split()]


def test_the_soft_limit_is_raised_to_the_hard_one_and_children_have_it() -> None:
    assert run("100:1500", "print(flush=True)\n" + OF_CHILD) == [100]
    assert run("100:1500", RAISE + "import sys; sys.stdout.flush()\n" + OF_CHILD) == [1500, 1500]


def test_a_limit_that_is_high_already_stays() -> None:
    assert run("1500:1500", RAISE) == [1500]
