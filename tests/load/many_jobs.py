"""A database of 10,000 sessions and 100,000 jobs of ten tenants, most of them finished, copied from a few real rows."""

from dataclasses import dataclass

import sqlalchemy as sa

from tests.worker.store.conftest import PREFLIGHT
from worker.store.model.rights import Scope
from worker.store.model.session_records import InputFile
from worker.store.model.work import ChunkPlan, StagePlan
from worker.store.spec import JobSpec
from worker.store.store import JobStore

NUM_TENANTS, NUM_SESSIONS, NUM_JOBS, NUM_QUEUED = 10, 10_000, 100_000, 1_000
# Names of the stages of a keypoint job, and their chunks: 20 of each job.
STAGES = {
    "check_session": 1,
    "associate": 1,
    "expect_bodies": 1,
    "identify": 1,
    "fit": 1,
    "poses": 6,
    "refit": 4,
    "write_people": 4,
    "export": 1,
}
CODE = "c" * 64


@dataclass(frozen=True)
class ManyJobs:
    """The store, and a key of each tenant."""

    store: JobStore
    engine: sa.Engine
    keys: dict[str, str]


def stages() -> tuple[StagePlan, ...]:
    return tuple(
        StagePlan(name, tuple(ChunkPlan(k, {"start_frame": k}, 10, f"{name}-{k}") for k in range(number)), CODE)
        for name, number in STAGES.items()
    )


def fill(url: str) -> ManyJobs:
    """Fill an empty database."""
    store = JobStore(url)
    store.migrate()
    keys = {
        f"tenant-{number}": store.keys.add(f"tenant-{number}", "load", {Scope.READ, Scope.WRITE})[1]
        for number in range(NUM_TENANTS)
    }
    session_id = store.sessions.reserve_id()
    files = [InputFile(f"cam_{k}.zip", "keypoints", f"sessions/x/inputs/{k}", 3_000_000, "1" * 64) for k in range(4)]
    store.sessions.add("take", files, PREFLIGHT, session_id)
    finished = store.jobs.add(session_id, JobSpec(), stages()).id
    while (claim := store.leases.claim("worker", 60.0)) is not None:
        store.leases.finish(claim.chunk_id, claim.lease_token, "0" * 64, 7)
    queued = store.jobs.add(session_id, JobSpec(), stages()).id
    engine = sa.create_engine(sa.make_url(url).set(drivername="postgresql+psycopg"))
    with engine.begin() as connection:
        copies = {"session": session_id, "finished": finished, "queued": queued}
        for statement in _COPIES:
            connection.execute(sa.text(statement), copies if ":" in statement else {})
    with engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
        connection.execute(sa.text("VACUUM ANALYZE"))
    return ManyJobs(store, engine, keys)


# Ids begin with their numbers, so that they grow as those of the service do.
_SESSION_ID = "lpad(to_hex({number}), 8, '0') || '-0000-7000-8000-000000000000'"
_JOB_ID = "lpad(to_hex({number}), 8, '0') || '-0000-7000-8000-000000000001'"


def _copies_of(table: str, rows: str, **columns: str) -> str:
    """Statement that copies a table's row of a condition for each number; ``columns`` are expressions of ``number``."""
    changed = ", ".join(f"'{name}', {value}" for name, value in columns.items())
    return (
        f"INSERT INTO {table} SELECT (jsonb_populate_record(one, jsonb_build_object({changed}))).* "  # noqa: S608 - ours
        f"FROM {table} one CROSS JOIN generate_series({rows}"
    )


_NAMES = "(ARRAY['walk','dance','jump','squat','fight','ballet'])[1 + number % 6] || ' ' || number"
_TENANT = f"'tenant-' || (number % {NUM_TENANTS})"
_OF_JOB = f"(number % {NUM_SESSIONS})"
_MOST_DONE = f"number > {NUM_JOBS - NUM_QUEUED}"
_TIME = "1760000000.0 + number * 20"
_COPIES = (
    _copies_of(
        "sessions",
        f"0, {NUM_SESSIONS - 1}) number WHERE one.id = :session",
        id=_SESSION_ID.format(number="number"),
        name=_NAMES,
        search_name=_NAMES,
        tenant=_TENANT,
        created_at=_TIME,
    ),
    _copies_of(
        "jobs",
        f"1, {NUM_JOBS}) number WHERE one.id = CASE WHEN {_MOST_DONE} THEN :queued ELSE :finished END",
        id=_JOB_ID.format(number="number"),
        session_id=_SESSION_ID.format(number=_OF_JOB),
        tenant=_TENANT,
        created_at=_TIME,
        queued_at=_TIME,
    ),
    _copies_of(
        "chunks",
        f"1, {NUM_JOBS}) number WHERE one.job_id = CASE WHEN {_MOST_DONE} THEN :queued ELSE :finished END",
        id="1000 + one.id + number * 100",
        job_id=_JOB_ID.format(number="number"),
    ),
    "DELETE FROM jobs WHERE id IN (:finished, :queued)",
    "SELECT setval(pg_get_serial_sequence('chunks', 'id'), (SELECT max(id) FROM chunks))",
)
