"""Data folder of a service on one machine, and its broker."""

import contextlib
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from pipeline.core.runtime.parent_watch import tied_to_parent
from tests.small_disk import fill, small_disk
from worker.run import embedded
from worker.store.files.disk import DiskSpace, make_private
from worker.store.queue import WorkQueue


@contextlib.contextmanager
def answering(directory: embedded.DataDirectory) -> Iterator[WorkQueue]:
    """Run the broker during the block."""
    program, queue = embedded.broker(directory), WorkQueue(directory.broker_url)
    with subprocess.Popen(tied_to_parent(program.command), env=program.env, stdout=subprocess.DEVNULL) as process:
        try:
            deadline_s = time.monotonic() + 120
            while not queue.ping() and time.monotonic() < deadline_s:
                time.sleep(0.05)
            yield queue
        finally:
            queue.close()
            process.terminate()


def test_folder_is_taken_once(tmp_path: Path) -> None:
    refused = pytest.raises(embedded.DataFolderError, match="Another service runs")
    with embedded.lock(tmp_path), refused, embedded.lock(tmp_path):
        pass
    with embedded.lock(tmp_path):
        pass


def test_folder_that_cannot_be_made_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(embedded.DataFolderError, match="can't be used"), embedded.lock(tmp_path / "file" / "data"):
        pass


def test_files_of_killed_process_are_removed(tmp_path: Path) -> None:
    with embedded.lock(tmp_path) as directory:
        (directory.temporary_dir / "left").mkdir()
    with embedded.lock(tmp_path) as directory:
        assert list(directory.temporary_dir.iterdir()) == []
        assert directory.environment()["TMPDIR"] == str(directory.temporary_dir)


def test_damaged_files_of_older_versions_broker_do_not_matter(tmp_path: Path) -> None:
    old = tmp_path / "broker" / "appendonlydir"
    old.mkdir(parents=True)
    (old / "appendonly.aof.1.incr.aof").write_bytes(b"*3\r\n$3\r\nSET" + bytes(4096))  # as after a power failure
    (old / "appendonly.aof.manifest").write_bytes(bytes(100))
    (old.parent / "dump.rdb").write_bytes(b"REDIS0011" + bytes(100))
    with embedded.lock(tmp_path) as directory, answering(directory) as queue:
        assert queue.publish()
    assert not old.exists()


def test_socket_fits_whatever_folder_and_is_ours_alone(tmp_path: Path) -> None:
    with embedded.lock(tmp_path / ("x" * 100)) as directory:
        assert len(str(directory.socket)) <= 100
        assert directory.socket.parent.stat().st_mode & 0o077 == 0
    assert not directory.socket.parent.exists()


def test_broker_answers_in_folder_of_any_name(tmp_path: Path) -> None:
    with embedded.lock(tmp_path / "ä b#c%41?") as directory, answering(directory) as queue:
        assert queue.publish()
        assert directory.socket.stat().st_mode & 0o077 == 0


def test_second_service_does_not_take_reserve_of_first(tmp_path: Path) -> None:
    with small_disk(tmp_path / "disk", 16) as disk, embedded.lock(disk / "data"):
        DiskSpace(disk / "data").set_aside()
        fill(disk / "filler")
        with pytest.raises(embedded.DataFolderError), embedded.lock(disk / "data"):
            pass
        assert (disk / "data" / "reserve").exists()


def test_folder_named_by_mistake_stays_as_it_is(tmp_path: Path) -> None:
    for folder, content in ((tmp_path / "others", "film.mp4"), (tmp_path / "old", "multicap.db")):
        folder.mkdir()
        folder.chmod(0o755)
        (folder / content).touch()
        make_private(folder)
    make_private(tmp_path / "new")
    modes = {folder.name: folder.stat().st_mode & 0o777 for folder in tmp_path.iterdir()}
    assert modes == {"others": 0o755, "old": 0o700, "new": 0o700}
