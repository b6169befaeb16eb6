"""Backups and restores that were killed: nothing half made stays, and the next try works."""

import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.worker.store.backups import Data, opened_data, restored
from worker.run import embedded
from worker.store.backup.linked import held_files

CREATE = """
import sys; from pathlib import Path
from tests.worker.store.backups import opened_data, restored
what, data, archive = sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3])
print("at work", flush=True)
if what == "create":
    with opened_data(data) as opened: opened.back_up(archive)
else:
    restored(archive, data)
"""


@pytest.mark.parametrize("what", ["create", "restore"])
def test_killed_backup_leaves_nothing_and_next_try_works(data: Data, tmp_path: Path, what: str) -> None:
    for _ in range(6):
        data.add_session(5_000_000)
    archive, there = tmp_path / "backup.tar", tmp_path / "there"
    if what == "restore":
        data.back_up(archive)
    target, other = (archive, data.folder) if what == "create" else (there, archive)
    partial = tmp_path / {"create": "backup.tar.part", "restore": "there.partial"}[what]
    arguments = [what, str(data.folder if what == "create" else there), str(archive)]
    num_killed = 0
    for wait_s in (0.0, 0.05, 0.15):
        with subprocess.Popen([sys.executable, "-c", CREATE, *arguments], stdout=subprocess.DEVNULL) as process:
            deadline_s = time.monotonic() + 120
            while not partial.exists() and process.poll() is None:
                assert time.monotonic() < deadline_s
            time.sleep(wait_s)
            process.send_signal(signal.SIGKILL)
        if process.returncode == 0:
            break
        num_killed += 1
        assert partial.exists()
        assert not target.exists()
    assert num_killed > 0
    assert other.exists()
    if target.exists():  # the last one was quicker than the kill
        shutil.rmtree(target) if target.is_dir() else target.unlink()
    if what == "create":
        assert data.back_up(archive).problems == ()
    restored(archive, there)
    with opened_data(there) as opened:
        assert opened.rows() == data.rows()
        assert opened.tree() == data.tree()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["backup.tar", "data", "there"]
    assert list((data.folder / ".backup").iterdir()) == []


def test_restore_that_was_killed_at_its_end_can_be_done_again(busy: Data, archive: Path, tmp_path: Path) -> None:
    there = tmp_path / "there"
    for folder in (".restoring", "artifacts/sessions/x", "uploads"):
        (there / folder).mkdir(parents=True)
    restored(archive, there)
    with opened_data(there) as opened:
        assert opened.rows() == busy.rows()
        assert opened.tree() == busy.tree()


def test_links_of_killed_backup_go_when_service_starts(data: Data) -> None:
    data.add_session()
    (path,) = (path for path in data.tree() if "/0-" in path)
    left = data.folder / ".backup" / "7"
    left.parent.mkdir()
    left.write_bytes(b"deleted long ago")
    with embedded.lock(data.folder):
        assert not left.exists()
    with held_files(data.folder) as links:
        assert links.hold(path) is not None
        with embedded.lock(data.folder):
            assert len(list(left.parent.iterdir())) == 1
