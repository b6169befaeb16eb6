"""Damaged and hostile archives are refused, and nothing of them is restored."""

import contextlib
import shutil
import sqlite3
import tarfile
from pathlib import Path

import pytest

from tests.worker.store.backup.archives import attempt, forged, members
from tests.worker.store.backups import ignore, restored
from worker.store.backup.contents import DATABASE, MANIFEST, PROBLEMS
from worker.store.backup.restore import verify_backup


def test_every_cut_is_noticed(archive: Path, tmp_path: Path) -> None:
    content = archive.read_bytes()
    cut = tmp_path / "cut.tar"
    for length in [0, 1, 511, *range(512, len(content), 16_384), len(content) - 1024, len(content) - 1]:
        cut.write_bytes(content[:length])
        for action in (lambda: verify_backup(cut, ignore), lambda: restored(cut, tmp_path / "there")):
            (sentence,) = attempt(action)
            assert "ends at byte" in sentence, (length, sentence)
    assert not (tmp_path / "there").exists()
    cut.write_bytes(content + b"\0")
    assert "damaged at byte" in attempt(lambda: verify_backup(cut, ignore))[0]
    assert "damaged at byte" in attempt(lambda: restored(cut, tmp_path / "there"))[0]


def test_every_flipped_bit_is_noticed(archive: Path, tmp_path: Path) -> None:
    content = archive.read_bytes()
    flipped = tmp_path / "flipped.tar"
    # All of a header and its padding, and then everywhere.
    offsets = [
        *range(0, 1600, 61),
        *range(1600, len(content), len(content) // 50),
        *range(len(content) - 1100, len(content), 211),
    ]
    for offset in offsets:
        bit = 1 << offset % 8
        flipped.write_bytes(content[:offset] + bytes([content[offset] ^ bit]) + content[offset + 1 :])
        assert attempt(lambda: restored(flipped, tmp_path / "there")), offset
        assert attempt(lambda: verify_backup(flipped, ignore)) or verify_backup(flipped, ignore).faults, offset
    assert sorted(path.name for path in tmp_path.iterdir()) == ["backup.tar", "data", "flipped.tar"]


@pytest.mark.parametrize(
    "name",
    [
        "/etc/cron.d/evil",
        "../evil",
        "artifacts/../../evil",
        "artifacts/sessions/..",
        "artifacts//etc/passwd",
        "artifacts/.incoming/evil",
        "uploads/a/b",
        "uploads/..",
        "evil",
        "serve.lock",
        "artifacts/never-named",
        "artifacts/" + "a" * 500,
        DATABASE,
    ],
)
def test_hostile_names_are_refused(archive: Path, tmp_path: Path, name: str) -> None:
    parts = members(archive)
    hostile = forged(tmp_path / "hostile.tar", [*parts[:2], (name, b"evil"), *parts[2:]])
    assert attempt(lambda: restored(hostile, tmp_path / "there"))
    assert attempt(lambda: verify_backup(hostile, ignore)) or verify_backup(hostile, ignore).faults
    assert sorted(path.name for path in tmp_path.iterdir()) == ["backup.tar", "data", "hostile.tar"]


@pytest.mark.parametrize(
    "kind",
    [tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.CHRTYPE, tarfile.DIRTYPE, tarfile.FIFOTYPE, tarfile.XHDTYPE,
     tarfile.GNUTYPE_SPARSE],
)  # fmt: skip
def test_links_devices_and_extensions_are_refused(archive: Path, tmp_path: Path, kind: bytes) -> None:
    parts = members(archive)
    with forged(tmp_path / "hostile.tar", parts[:2]).open("r+b") as file:
        end = sum(512 + len(content) + -len(content) % 512 for _, content in parts[:2])
        file.seek(end)
        info = tarfile.TarInfo("artifacts/link")
        info.type, info.linkname, info.size = kind, "/etc/passwd", 8 * 2**30 if kind == tarfile.XHDTYPE else 0
        file.write(info.tobuf(tarfile.GNU_FORMAT))
        file.truncate()
    (sentence,) = attempt(lambda: restored(tmp_path / "hostile.tar", tmp_path / "there"))
    assert f"damaged at byte {end}" in sentence
    assert not (tmp_path / "there").exists()


def test_hostile_databases_are_refused(archive: Path, tmp_path: Path) -> None:
    parts = members(archive)

    def with_database(*statements: str) -> tuple[str, ...]:
        path = tmp_path / "hostile.db"
        path.write_bytes(parts[1][1])
        with contextlib.closing(sqlite3.connect(path)) as database:
            for statement in statements:
                database.execute(statement)
            database.commit()
        hostile = forged(tmp_path / "hostile.tar", [parts[0], (DATABASE, path.read_bytes()), *parts[2:]])
        return attempt(lambda: restored(hostile, tmp_path / "there"))

    assert with_database() == ()
    shutil.rmtree(tmp_path / "there")
    trigger = "CREATE TRIGGER evil AFTER INSERT ON jobs BEGIN DELETE FROM keys; END"
    assert "'evil'" in with_database(trigger)[0]
    assert "no key" in with_database("UPDATE results SET key = '../../../etc/passwd'")[0]
    assert "no key" in with_database("UPDATE uploads SET id = '../x'")[0]
    assert "does not name" in with_database("UPDATE results SET key = 'jobs/x/results/y'")[0]
    assert "no JSON" in with_database("UPDATE sessions SET files = '{'")[0]
    assert "not what the database says" in with_database("UPDATE results SET sha256 = num_bytes")[0]
    assert "a row refers" in with_database("PRAGMA foreign_keys = OFF", "DELETE FROM sessions")[0]
    for statement in ("DROP TABLE results", "DROP TABLE alembic_version", "DELETE FROM alembic_version"):
        assert with_database(statement), statement
    assert not (tmp_path / "there").exists()


def test_archives_that_are_none(archive: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    assert "No such file" in attempt(lambda: verify_backup(other, ignore))[0]
    other.write_bytes(b"PK\3\4" + bytes(5000))
    assert "no backup of Multicap" in attempt(lambda: verify_backup(other, ignore))[0]
    parts = members(archive)
    for some in ([], parts[1:], [parts[0], *parts[2:]], parts[:-1], [*parts, ("artifacts/x", b"")]):
        forged(other, some)
        assert attempt(lambda: verify_backup(other, ignore)), len(some)
    newer = parts[0][1].replace(b'"format": 1', b'"format": 2')
    assert newer != parts[0][1]
    assert "format 2" in attempt(lambda: verify_backup(forged(other, [(MANIFEST, newer), *parts[1:]]), ignore))[0]
    undeclared = [part for part in parts if not part[0].endswith("/record")]
    assert all("is missing" in fault for fault in verify_backup(forged(other, undeclared), ignore).faults)
    assert "is missing" in attempt(lambda: restored(other, tmp_path / "there"))[0]
    assert parts[-1][0] == PROBLEMS
