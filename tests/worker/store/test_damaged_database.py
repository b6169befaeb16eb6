"""SQLite files that are damaged for real: found before anything is written, and said in plain words."""

import contextlib
import os
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from itertools import cycle
from pathlib import Path

import pytest
from sqlalchemy.exc import SQLAlchemyError

from tests.worker.store.backups import ignore, stopped_service
from tests.worker.store.damage import DAMAGES, copy_of, middle, overwrite
from worker.store.backup.create import create_backup
from worker.store.database.connection import Database
from worker.store.errors import DamagedDatabase
from worker.store.store import JobStore

PROGRAMS = ("worker", "worker.run.reaper", "api")
EACH_DAMAGE = pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES.keys())


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return stopped_service(tmp_path_factory.mktemp("whole") / "data")


@pytest.fixture
def database(whole: Path, tmp_path: Path) -> Path:
    return copy_of(whole, tmp_path / "data")


def store_of(database: Path) -> contextlib.closing[JobStore]:
    return contextlib.closing(JobStore(f"sqlite:///{database}"))


@EACH_DAMAGE
def test_damaged_file_is_found_before_write(database: Path, damage: Callable[[Path], None]) -> None:
    damage(database)
    before = database.read_bytes()
    with store_of(database) as store:
        with pytest.raises(DamagedDatabase) as refused:
            store.migrate()
        assert refused.value.path == database
        text = f"{refused.value}\n{refused.value.instructions()}"
        assert str(database) in text
        assert "multicap backup restore" in text
        assert f"mv {database}* " in text
    assert database.read_bytes() == before


@EACH_DAMAGE
def test_damaged_file_gets_no_backup(database: Path, tmp_path: Path, damage: Callable[[Path], None]) -> None:
    damage(database)
    with pytest.raises(DamagedDatabase) as refused:
        create_backup(database.parent, f"sqlite:///{database}", "", tmp_path / "b.tar", ignore)
    assert refused.value.path == database
    assert [path.name for path in tmp_path.iterdir()] == ["data"]


# Each damage with one of the programs, which take seconds to start: all of them migrate the database first.
@pytest.mark.parametrize(
    ("damage", "module"),
    [pytest.param(DAMAGES[name], module, id=f"{name}-{module}") for name, module in zip(DAMAGES, cycle(PROGRAMS))],
)
def test_programs_end_with_sentences(database: Path, damage: Callable[[Path], None], module: str) -> None:
    damage(database)
    environment = os.environ | {"MULTICAP_DATA_DIR": str(database.parent), "MULTICAP_PORT": "0"}
    ended = subprocess.run(
        [sys.executable, "-m", module], env=environment, capture_output=True, text=True, timeout=120, check=False
    )
    assert ended.returncode == 1
    assert ended.stderr.startswith(f"error: The database {database} is damaged: ")
    assert "multicap backup restore" in ended.stderr
    assert "Traceback" not in ended.stderr


def read_all(store: JobStore) -> None:
    for job in store.jobs.page():
        store.jobs.attempts(job.id)
        store.results.downloads(job.id)
        store.sessions.get(job.session_id)


def test_damage_instructions_can_be_followed(database: Path, tmp_path: Path) -> None:
    overwrite(database, 0, bytes(100))
    with store_of(database) as store, pytest.raises(DamagedDatabase) as refused:
        store.migrate()
    (aside,) = [line for line in refused.value.instructions().splitlines() if " mv " in line]
    subprocess.run(["sh", "-c", aside], check=True)
    assert (database.parent / "damaged" / database.name).exists()
    with store_of(database) as store:
        store.migrate()
        assert store.jobs.page() == []


def test_once_damage_was_met_nothing_is_read_or_written_any_more(database: Path) -> None:
    with store_of(database) as store:
        assert store.ping()
        assert len(store.jobs.page()) == 30
        assert not store.is_damaged
        overwrite(database, middle(database), bytes(database.stat().st_size - middle(database)))
        with store_of(database) as other, contextlib.suppress(SQLAlchemyError):
            other.webhook_secrets.rotate("studio", 0.0)  # whose commit has all others read anew
        with pytest.raises(DamagedDatabase):
            read_all(store)
        assert store.is_damaged
        assert not store.ping()
        for act in (store.keys.all, store.workers.all, lambda: store.leases.claim("worker", 1.0), store.figures):
            with pytest.raises(DamagedDatabase):
                act()


@pytest.mark.parametrize("value", [b'{"cameras', b'{"cameras\xff"}'])
def test_unreadable_row_is_damage(database: Path, value: bytes) -> None:
    with contextlib.closing(sqlite3.connect(database)) as connection, connection:
        connection.execute("UPDATE sessions SET preflight = CAST(? AS TEXT)", [value])
    with store_of(database) as store:
        store.migrate()
        with pytest.raises(DamagedDatabase):
            store.sessions.page()


def test_empty_file_without_sessions_is_new_database(tmp_path: Path) -> None:
    (tmp_path / "multicap.db").touch()
    with store_of(tmp_path / "multicap.db") as store:
        store.migrate()
        assert store.ping()


def test_errors_of_other_kinds_are_no_damage(database: Path) -> None:
    with contextlib.closing(Database(f"sqlite:///{database}")) as opened:
        with pytest.raises(SQLAlchemyError) as error, opened.reading() as connection:
            connection.exec_driver_sql("SELECT nothing FROM nowhere")
        assert not isinstance(error.value, DamagedDatabase)
        assert not opened.is_damaged
