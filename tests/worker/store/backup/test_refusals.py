"""Backups that existing files, other schemas or a full disk prevent."""

import contextlib
import shutil
import sqlite3
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.worker.store.backup.archives import attempt, forged, members
from tests.worker.store.backups import Data, ignore, opened_data, restored
from worker.store.backup.archive import BackupUsageError
from worker.store.backup.contents import DATABASE
from worker.store.backup.create import create_backup
from worker.store.backup.linked import held_files


def test_nothing_is_overwritten(busy: Data, archive: Path, tmp_path: Path) -> None:
    content = archive.read_bytes()
    assert "is there already" in attempt(lambda: busy.back_up(archive))[0]
    assert archive.read_bytes() == content
    assert "is not empty" in attempt(lambda: restored(archive, busy.folder))[0]
    with held_files(busy.folder):
        assert "Another backup" in attempt(lambda: busy.back_up(tmp_path / "second.tar"))[0]
    assert "There is no folder" in attempt(lambda: busy.back_up(tmp_path / "no" / "backup.tar"))[0]
    assert not (tmp_path / "second.tar.part").exists()
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(BackupUsageError, match="no database"):
        create_backup(empty, f"sqlite:///{empty / DATABASE}", "", tmp_path / "second.tar", ignore)
    restored(archive, empty)
    with opened_data(empty) as there:
        assert there.rows() == busy.rows()


def test_newer_schema_is_refused(busy: Data, archive: Path, tmp_path: Path) -> None:
    parts = members(archive)
    path = tmp_path / "newer.db"
    path.write_bytes(parts[1][1])
    for database in (path, busy.folder / DATABASE):
        with contextlib.closing(sqlite3.connect(database)) as opened:
            opened.execute("UPDATE alembic_version SET version_num = '9999'")
            opened.commit()
    newer = forged(tmp_path / "newer.tar", [parts[0], (DATABASE, path.read_bytes()), *parts[2:]])
    for action in (
        lambda: restored(newer, tmp_path / "there"),
        lambda: busy.back_up(tmp_path / "again.tar"),
        busy.store.migrate,
    ):
        assert "9999" in attempt(action)[0]
    assert not (tmp_path / "there").exists()
    assert not (tmp_path / "again.tar").exists()


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    folder = tmp_path / "disk"
    folder.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=4m", "tmpfs", folder], check=False).returncode != 0:
        pytest.skip("this machine lets us mount nothing")
    yield folder
    subprocess.run(["umount", "--lazy", folder], check=True)


def test_small_disk_is_refused_before_and_full_one_in_middle(
    data: Data, small_disk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for _ in range(2):
        data.add_session(2_000_000)
    assert data.back_up(tmp_path / "backup.tar").problems == ()
    sentence = attempt(lambda: data.back_up(small_disk / "backup.tar"))[0]
    assert "needs 8 MB" in sentence
    assert "needs 8 MB" in attempt(lambda: restored(tmp_path / "backup.tar", small_disk / "there"))[0]
    # Others fill it meanwhile.
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
    for action in (
        lambda: data.back_up(small_disk / "backup.tar"),
        lambda: restored(tmp_path / "backup.tar", small_disk / "there"),
    ):
        assert "is full" in attempt(action)[0]
    assert list(small_disk.iterdir()) == []
