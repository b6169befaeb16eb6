"""Room on the disk: headroom, reserve, and errors that say that there is none."""

import contextlib
import errno
import sqlite3
from collections.abc import Iterator
from pathlib import Path

import pytest
from sqlalchemy import create_engine, text
from sqlalchemy.exc import OperationalError

from tests.small_disk import fill, small_disk
from worker.store.files.disk import DiskSpace, append_whole, is_disk_full


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    with small_disk(tmp_path / "disk", 16) as folder:
        yield folder


def test_headroom_is_part_of_disk_unless_it_is_set(disk: Path) -> None:
    assert DiskSpace(disk).headroom_bytes == 16 * 2**20 // 20
    assert DiskSpace(disk, 5).headroom_bytes == 5
    assert DiskSpace(disk, 16 * 2**20).has_room(0)
    assert not DiskSpace(disk, 16 * 2**20).has_room(1)


def test_disk_without_inodes_has_no_room(tmp_path: Path) -> None:
    with small_disk(tmp_path / "disk", 16, num_inodes=200) as disk:
        space = DiskSpace(disk)
        assert space.has_room()
        with contextlib.suppress(OSError):
            for number in range(200):
                (disk / str(number)).touch()
        assert space.free_bytes > space.headroom_bytes
        assert not space.has_room()
        (disk / "0").unlink()
        assert not space.has_room()  # work under way needs some


def test_reserve_is_room_that_only_deleting_gets(disk: Path) -> None:
    space = DiskSpace(disk)
    free_bytes = space.free_bytes
    space.set_aside()
    space.set_aside()
    reserve_bytes = free_bytes - space.free_bytes
    assert 2**18 < reserve_bytes < 2**19
    fill(disk / "filler")
    assert space.free_bytes == 0
    assert not space.has_room()

    tried = []

    def delete() -> int:
        tried.append(space.free_bytes)
        return (disk / "journal").write_bytes(bytes(100_000))

    assert space.using_reserve(delete) == 100_000
    assert tried == [0, reserve_bytes]
    # Some of what is left is kept for the next one, however fast others fill the disk.
    fill(disk / "filler")
    assert 0 < (disk / "reserve").stat().st_size < reserve_bytes
    assert space.using_reserve(delete) == 100_000
    (disk / "filler").unlink()
    space.set_aside()
    assert (disk / "reserve").stat().st_size == 16 * 2**20 // 50


def test_other_errors_cost_no_reserve(tmp_path: Path) -> None:
    space = DiskSpace(tmp_path, 0)
    (tmp_path / "reserve").touch()

    def fail() -> None:
        raise PermissionError(errno.EACCES, "no")

    with pytest.raises(PermissionError):
        space.using_reserve(fail)
    assert (tmp_path / "reserve").exists()


def test_sqlite_s_words_for_full_disk_are_known(disk: Path) -> None:
    fill(disk / "filler")
    engine = create_engine(f"sqlite:///{disk / 'multicap.db'}")
    with pytest.raises(OperationalError) as raised, engine.begin() as connection:
        connection.execute(text("CREATE TABLE some (thing TEXT)"))
    engine.dispose()
    assert is_disk_full(raised.value)


def test_locked_database_is_no_full_disk(tmp_path: Path) -> None:
    path = tmp_path / "multicap.db"
    with contextlib.closing(sqlite3.connect(path)) as one, contextlib.closing(sqlite3.connect(path, timeout=0)) as two:
        one.execute("BEGIN IMMEDIATE")
        with pytest.raises(sqlite3.OperationalError) as raised:
            two.execute("BEGIN IMMEDIATE")
    assert not is_disk_full(raised.value)
    assert is_disk_full(OSError(errno.ENOSPC, "full"))
    assert is_disk_full(OSError(errno.EDQUOT, "quota"))
    assert not is_disk_full(ValueError("full"))


def test_content_that_does_not_fit_is_not_appended(disk: Path) -> None:
    path = disk / "file"
    append_whole(path, b"first")
    fill(disk / "others")
    with pytest.raises(OSError, match="No space left"):
        append_whole(path, bytes(3 * 2**20))
    assert path.read_bytes() == b"first"
    (disk / "others").unlink()
    append_whole(path, b", second")
    assert path.read_bytes() == b"first, second"
