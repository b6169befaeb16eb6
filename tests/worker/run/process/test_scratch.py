"""Temporary folders of killed processes are removed by the next process."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from worker.run.process.scratch import remove_abandoned, scratch_folder

LEAVE_A_FOLDER = """
import os, signal
from worker.run.process.scratch import scratch_folder
with scratch_folder() as folder:
    (folder / "person-1.bvh").write_bytes(b"HIERARCHY")
    print(folder, flush=True)
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.fixture(autouse=True)
def temporary_dir(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def test_a_folder_is_gone_after_its_block(temporary_dir: Path) -> None:
    with scratch_folder() as folder:
        (folder / "person-1.bvh").write_bytes(b"HIERARCHY")
        assert folder.parent == temporary_dir
    assert list(temporary_dir.iterdir()) == []


def test_folders_of_killed_processes_go_and_nothing_else(temporary_dir: Path) -> None:
    kept = ["multicap-notes", f"multicap-{2**70}-other", "multicap-1-init", "other-99999999-x"]
    for name in kept:
        (temporary_dir / name).mkdir()
    killed = subprocess.run(
        [sys.executable, "-c", LEAVE_A_FOLDER],
        env=os.environ | {"TMPDIR": str(temporary_dir)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert Path(killed.stdout.strip()).is_dir()
    with scratch_folder() as mine:
        remove_abandoned()
        assert sorted(path.name for path in temporary_dir.iterdir()) == sorted([*kept, mine.name])
