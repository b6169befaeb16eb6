"""Every migration, down and up again, with data in place."""

from collections.abc import Iterator
from dataclasses import replace

import pytest
import sqlalchemy as sa
from alembic import command
from alembic.autogenerate import compare_metadata
from alembic.config import Config
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory

from tests.worker.jobs.conftest import Bench, stages
from worker.jobs.database.tables import metadata
from worker.jobs.errors import NewerDatabase
from worker.jobs.model import Problem, Scope

CONFIG = Config()
CONFIG.set_main_option("script_location", "worker.jobs.database:migrations")
REVISIONS = [script.revision for script in ScriptDirectory.from_config(CONFIG).walk_revisions()]


@pytest.fixture
def engine(jobs: Bench) -> Iterator[sa.Engine]:
    engine = sa.create_engine(jobs.url)
    if engine.dialect.name == "sqlite":
        sa.event.listen(engine, "connect", lambda connection, _: connection.execute("PRAGMA foreign_keys = ON"))
    yield engine
    engine.dispose()


def migrate(engine: sa.Engine, step: str, revision: str) -> None:
    with engine.begin() as connection:
        CONFIG.attributes["connection"] = connection
        getattr(command, step)(CONFIG, revision)


def add_data(jobs: Bench) -> list[str]:
    """A finished job, one that failed and was retried, one that runs, and a key."""
    done = jobs.queue()
    jobs.finish_all()
    failed = jobs.queue()
    claim = jobs.claim()
    jobs.store.fail(claim.chunk_id, claim.lease_token, Problem("broken", "It is broken."))
    jobs.store.retry(failed.id, stages())
    jobs.finish(jobs.claim())
    jobs.store.create_key("studio", "portal", {Scope.READ})
    return [failed.id, done.id]


def everything(jobs: Bench, job_id: str) -> object:
    timeless = [replace(one, eta_s=None) for one in jobs.store.jobs()]
    return jobs.store.sessions(), timeless, jobs.store.results(job_id)


def test_down_and_up_again_keeps_sessions_jobs_and_results(jobs: Bench, engine: sa.Engine) -> None:
    ids = add_data(jobs)
    before = everything(jobs, ids[1])
    for revision in REVISIONS[1:]:
        migrate(engine, "downgrade", revision)
    for revision in reversed(REVISIONS[:-1]):
        migrate(engine, "upgrade", revision)
    with engine.connect() as connection:
        assert compare_metadata(MigrationContext.configure(connection), metadata) == []
    assert everything(jobs, ids[1]) == before
    assert jobs.store.usage().stored_bytes > 3_000_000_000
    # And it goes on.
    jobs.finish_all()
    assert {one.state for one in jobs.store.jobs()} == {"succeeded"}


@pytest.mark.parametrize("revision", REVISIONS[1:])
def test_each_step_down_can_be_taken_back_alone(jobs: Bench, engine: sa.Engine, revision: str) -> None:
    add_data(jobs)
    before = jobs.store.sessions(), [one.id for one in jobs.store.jobs()]
    migrate(engine, "downgrade", revision)
    migrate(engine, "upgrade", "head")
    assert (jobs.store.sessions(), [one.id for one in jobs.store.jobs()]) == before


def test_a_schema_of_a_newer_version_is_refused_and_left_alone(jobs: Bench, engine: sa.Engine) -> None:
    with engine.begin() as connection:
        connection.execute(sa.text("UPDATE alembic_version SET version_num = '0099'"))
    with pytest.raises(NewerDatabase, match=r"newer version of Multicap \(schema 0099\)"):
        jobs.store.migrate()
    with engine.connect() as connection:
        assert connection.execute(sa.text("SELECT version_num FROM alembic_version")).scalar() == "0099"
        connection.rollback()
    with engine.begin() as connection:
        connection.execute(sa.text("UPDATE alembic_version SET version_num = :now"), {"now": REVISIONS[0]})
    jobs.store.migrate()
