"""A migrated store on each database, and jobs of two stages on it."""

import contextlib
import os
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa
import uuid_utils
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext

from pipeline.capture.preflight_record import Preflight, PreflightCamera, PreflightTimebase
from pipeline.core.findings import Finding
from pipeline.core.problems.finding_codes import CLOCKS_DISAGREE
from tests.postgres import POSTGRES_VARIABLE, running_postgres
from worker.store.database.tables import metadata
from worker.store.model.job_records import JobRecord, Result
from worker.store.model.session_records import InputFile
from worker.store.model.work import ChunkPlan, Claim, StagePlan
from worker.store.spec import JobSpec, Priority
from worker.store.store import JobStore

LEASE_S = 60.0
EXPIRED_S = -1.0  # a lease that ended before it began

UNITS = 10
CODE = "c" * 64

PREFLIGHT = Preflight(
    cameras=(PreflightCamera("cam one", "cam one.mp4", (640, 480), 25.0, 60),),
    timebase=PreflightTimebase(0.0, 25.0, 60),
    stretches=(range(60),),
    findings=(Finding(CLOCKS_DISAGREE, "The clocks drift."),),
)


def stages(num_chunks: int = 3) -> tuple[StagePlan, ...]:
    """A map and a reduce."""
    chunks = tuple(ChunkPlan(k, {"start_frame": k}, UNITS, f"detect-{k}") for k in range(num_chunks))
    return StagePlan("detect", chunks, CODE), StagePlan("export", (ChunkPlan(0, {}, UNITS, "export"),), CODE)


def result(job_id: str, name: str = "person-1.bvh") -> Result:
    key = f"jobs/{job_id}/results/{name}"
    return Result(name, "bvh", 1, "text/plain", key, 5, "5" * 64, person_name="person-1")


@dataclass(frozen=True)
class StoreBench:
    """A store with a session."""

    url: str
    store: JobStore
    session_id: str

    def queue(self, num_chunks: int = 3, priority: Priority = "normal") -> JobRecord:
        return self.store.jobs.add(self.session_id, JobSpec(priority=priority), stages(num_chunks))

    def claim(self, lease_s: float = LEASE_S) -> Claim:
        claim = self.store.leases.claim("worker", lease_s)
        assert claim is not None
        return claim

    def finish(self, claim: Claim) -> bool:
        results = [result(claim.job_id)] if claim.stage == "export" else []
        sha256 = claim.output_key.ljust(64, "0")
        return self.store.leases.finish(claim.chunk_id, claim.lease_token, sha256, 7, results=results)

    def finish_all(self) -> None:
        while claim := self.store.leases.claim("worker", LEASE_S):
            self.finish(claim)

    def execute(self, statement: sa.Executable) -> None:
        """Change the database behind the store's back."""
        engine = sa.create_engine(self.url)
        with engine.begin() as connection:
            connection.execute(statement)
        engine.dispose()


def schema_differences(connection: sa.Connection) -> list[Any]:
    """Changes after which a database would have the tables, and the indexes of its dialect."""

    def is_of_dialect(thing: sa.schema.SchemaItem, *_: object) -> bool:
        return thing.info.get("dialect") in (None, connection.dialect.name)

    options = {"compare_type": True, "include_object": is_of_dialect}
    return list(compare_metadata(MigrationContext.configure(connection, opts=options), metadata))


def new_session(store: JobStore) -> str:
    session_id = store.sessions.reserve_id()
    files = [
        InputFile("cam one.mp4", "video", f"sessions/{session_id}/inputs/0-cam_one.mp4", 3_000_000_000, "1" * 64),
        InputFile("rig.toml", "calibration", f"sessions/{session_id}/inputs/1-rig.toml", 200, "2" * 64),
    ]
    store.sessions.add("take", files, PREFLIGHT, session_id)
    return session_id


@pytest.fixture(scope="session")
def postgres_url() -> Iterator[str]:
    """A server that others have started, or one of our own."""
    if url := os.environ.get(POSTGRES_VARIABLE):
        yield url
        return
    with running_postgres() as server:
        yield server.url


@pytest.fixture(params=["sqlite", "postgresql"])
def backend(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="session")
def postgres(postgres_url: str) -> Iterator[sa.Engine]:
    """The server, for who makes databases and drops them."""
    url = sa.make_url(postgres_url).set(drivername="postgresql+psycopg")
    server = sa.create_engine(url, isolation_level="AUTOCOMMIT")
    yield server
    server.dispose()


@contextlib.contextmanager
def postgres_database(server: sa.Engine, template: str = "template1") -> Iterator[str]:
    """A database of our own, a copy of another."""
    url = server.url.set(database=f"multicap_test_{uuid_utils.uuid4().hex}")
    with server.connect() as connection:
        connection.execute(sa.text(f"CREATE DATABASE {url.database} TEMPLATE {template}"))
    yield url.render_as_string(hide_password=False)
    with server.connect() as connection:
        connection.execute(sa.text(f"DROP DATABASE {url.database} WITH (FORCE)"))


def migrate(url: str) -> None:
    store = JobStore(url)
    store.migrate()
    store.close()


@pytest.fixture(scope="session")
def migrated_postgres(postgres: sa.Engine) -> Iterator[str]:
    """Name of a database with the schema and nothing in it: a copy is made faster than all migrations."""
    with postgres_database(postgres) as url:
        migrate(url)
        yield str(sa.make_url(url).database)


@pytest.fixture(scope="session")
def migrated_sqlite(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Likewise a file."""
    path = tmp_path_factory.mktemp("migrated") / "jobs.db"
    migrate(f"sqlite:///{path}")
    return path


@pytest.fixture
def empty_database_url(backend: str, request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[str]:
    """A database of our own without anything."""
    if backend == "sqlite":
        yield f"sqlite:///{tmp_path / 'empty.db'}"
        return
    with postgres_database(request.getfixturevalue("postgres")) as url:
        yield url


@pytest.fixture
def database_url(backend: str, request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[str]:
    """A database of our own with the schema."""
    if backend == "sqlite":
        yield f"sqlite:///{shutil.copy(request.getfixturevalue('migrated_sqlite'), tmp_path / 'jobs.db')}"
        return
    server, template = request.getfixturevalue("postgres"), request.getfixturevalue("migrated_postgres")
    with postgres_database(server, template) as url:
        yield url


@pytest.fixture
def new_store(database_url: str) -> Iterator[Callable[[], JobStore]]:
    """Stores on one database, as several processes would have them."""
    made: list[JobStore] = []

    def new() -> JobStore:
        made.append(JobStore(database_url))
        return made[-1]

    yield new
    for store in made:
        store.close()


@pytest.fixture
def jobs(database_url: str, new_store: Callable[[], JobStore]) -> StoreBench:
    store = new_store()
    return StoreBench(database_url, store, new_session(store))
