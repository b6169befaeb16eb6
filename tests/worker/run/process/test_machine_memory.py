"""Memory of the machine, and limits of cgroups."""

from pathlib import Path

import psutil
import pytest

from worker.run.process.machine_memory import machine_memory_bytes

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
def test_the_least_limit_of_all_groups_holds(tmp_path: Path, limits: dict[str, str], expected: int | None) -> None:
    groups, of_process = tmp_path / "cgroup", tmp_path / "of_process"
    (groups / "jobs" / "worker").mkdir(parents=True)
    for name, limit in limits.items():
        (groups / name / "memory.max").write_text(limit)
    of_process.write_text("0::/jobs/worker\n")
    whole = psutil.virtual_memory().total if expected is None else expected
    assert machine_memory_bytes(groups, of_process) == int(0.9 * whole)


def test_without_cgroups_the_machine_counts(tmp_path: Path) -> None:
    missing = tmp_path / "missing"
    assert machine_memory_bytes(missing, missing) == int(0.9 * psutil.virtual_memory().total)
