"""Every migration, down and up again, with data in place."""

from collections.abc import Iterator
from dataclasses import replace

import pytest
import sqlalchemy as sa
from alembic import command
from alembic.config import Config
from alembic.script import ScriptDirectory

from pipeline.core.problems.model import Code
from tests.worker.store.conftest import StoreBench, schema_differences, stages
from worker.store.database.connection import schema_revisions
from worker.store.errors import KeyBusy, NewerDatabase
from worker.store.model.jobs import JobProblem
from worker.store.model.recordings import RecordingLimits, UploadingPhone
from worker.store.model.rights import Scope
from worker.store.repositories.idempotency_keys import KeyClaim

CONFIG = Config()
CONFIG.set_main_option("script_location", "worker.store.database:migrations")
REVISIONS = [script.revision for script in ScriptDirectory.from_config(CONFIG).walk_revisions()]


@pytest.fixture
def engine(jobs: StoreBench) -> Iterator[sa.Engine]:
    engine = sa.create_engine(jobs.url)
    if engine.dialect.name == "sqlite":
        sa.event.listen(engine, "connect", lambda connection, _: connection.execute("PRAGMA foreign_keys = ON"))
    yield engine
    engine.dispose()


def migrate(engine: sa.Engine, step: str, revision: str) -> None:
    with engine.begin() as connection:
        CONFIG.attributes["connection"] = connection
        getattr(command, step)(CONFIG, revision)


def test_revisions_are_those_of_alembic() -> None:
    assert schema_revisions() == tuple(reversed(REVISIONS))


def add_data(jobs: StoreBench) -> list[str]:
    """A finished job, one that failed and was retried, one that runs, and a key."""
    done = jobs.queue()
    jobs.finish_all()
    failed = jobs.queue()
    claim = jobs.claim()
    jobs.store.leases.fail(claim.chunk_id, claim.lease_token, JobProblem(Code("broken"), "It is broken."))
    jobs.store.jobs.retry(failed.id, stages())
    jobs.finish(jobs.claim())
    jobs.store.keys.add("studio", "portal", {Scope.READ})
    return [failed.id, done.id]


def everything(jobs: StoreBench, job_id: str) -> object:
    timeless = [replace(one, eta_s=None) for one in jobs.store.jobs.page()]
    return jobs.store.sessions.page(), timeless, jobs.store.results.of_job(job_id)


@pytest.mark.slow
def test_down_and_up_again_keeps_sessions_jobs_and_results(jobs: StoreBench, engine: sa.Engine) -> None:
    ids = add_data(jobs)
    before = everything(jobs, ids[1])
    for revision in REVISIONS[1:]:
        migrate(engine, "downgrade", revision)
    for revision in reversed(REVISIONS[:-1]):
        migrate(engine, "upgrade", revision)
    with engine.connect() as connection:
        assert schema_differences(connection) == []
    assert everything(jobs, ids[1]) == before
    assert jobs.store.of("default").usage().stored_bytes > 3_000_000_000
    # And it goes on.
    jobs.finish_all()
    assert {one.state for one in jobs.store.jobs.page()} == {"succeeded"}


# The latest steps and the first one; every fourth of the others is a slow test, and all are gone down and up one after
# the other above.
@pytest.mark.parametrize(
    "revision",
    [
        *REVISIONS[1:4],
        *(pytest.param(revision, marks=pytest.mark.slow) for revision in REVISIONS[4:-1:4]),
        REVISIONS[-1],
    ],
)
def test_each_step_down_can_be_taken_back_alone(jobs: StoreBench, engine: sa.Engine, revision: str) -> None:
    add_data(jobs)
    before = jobs.store.sessions.page(), [one.id for one in jobs.store.jobs.page()]
    migrate(engine, "downgrade", revision)
    migrate(engine, "upgrade", "head")
    assert (jobs.store.sessions.page(), [one.id for one in jobs.store.jobs.page()]) == before


def test_answers_of_idempotency_keys_are_kept(jobs: StoreBench, engine: sa.Engine) -> None:
    keys = jobs.store.of("studio").idempotency_keys
    answer = {"status": 202, "headers": {"Location": "/v1/jobs/1"}, "body": "{}"}
    claims = [keys.claim(name, "f" * 64, 60.0) for name in ("answered", "at work")]
    assert isinstance(claims[0], KeyClaim)
    keys.answer(claims[0], answer)
    migrate(engine, "downgrade", "0019")
    with engine.connect() as connection:
        rows = connection.execute(sa.text("SELECT key, status, body FROM receipts ORDER BY key")).all()
    assert [tuple(row) for row in rows] == [("answered", 202, "{}"), ("at work", None, None)]
    migrate(engine, "upgrade", "head")
    assert keys.claim("answered", "f" * 64, 60.0) == answer
    with pytest.raises(KeyBusy):
        keys.claim("at work", "f" * 64, 60.0)


def test_a_schema_of_a_newer_version_is_refused_and_left_alone(jobs: StoreBench, engine: sa.Engine) -> None:
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


def test_uploads_of_phones_stay_when_recordings_go(jobs: StoreBench, engine: sa.Engine) -> None:
    records = jobs.store.of("studio")
    recording, _ = records.recordings.add("Rehearsal", 3600.0)
    limits = RecordingLimits(phones=2, takes=2, take_s=60.0)
    records.recordings.join(recording.id, "the-secret-of-a-phone", "Phone", "Chrome", limits)
    phone = UploadingPhone(recording.id, 1, 5, 100)
    jobs.store.of("studio", phone=phone).uploads.add("upload", "a.webm", 5, "", 3600.0, "here")
    migrate(engine, "downgrade", "0036")
    migrate(engine, "upgrade", "head")
    assert (records.recordings.page(), records.uploads.get("upload").num_bytes) == ([], 5)
    again, _ = records.recordings.add("Rehearsal", 3600.0)
    assert [found.id for found in records.recordings.page()] == [again.id]
