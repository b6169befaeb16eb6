"""Service on PostgreSQL: the same bytes as on SQLite, even if the server restarts during a job."""

import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import sqlalchemy as sa

from pipeline.capture.keypoints import open_keypoints
from pipeline.core.options.config import Method, ReconstructionConfig
from pipeline.export.results import write_results
from pipeline.run.engine.local import reconstruct
from tests.e2e.serving import Served, digests, serving
from tests.e2e.test_serve_keypoints import capture, files
from tests.postgres import Postgres, running_postgres

__all__ = ["capture"]


@pytest.fixture(scope="module")
def postgres() -> Iterator[Postgres]:
    with running_postgres() as server:
        yield server


@pytest.fixture(scope="module")
def on_postgres(postgres: Postgres, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    settings = {"MULTICAP_DATABASE_URL": postgres.url, "MULTICAP_REAP_INTERVAL_S": "1"}
    with serving(tmp_path_factory.mktemp("data"), **settings) as served:
        yield served


@pytest.mark.parametrize("method", ["tracking", "clustering"])
def test_same_bytes_also_when_server_is_restarted(
    on_postgres: Served, postgres: Postgres, capture: Path, tmp_path: Path, method: Method
) -> None:
    session = open_keypoints(capture / "keypoints", capture / "calibration.json", capture / "timestamps.csv")
    write_results(reconstruct(session, ReconstructionConfig(method=method)), tmp_path)
    spec = ("spec", (None, f'{{"method": "{method}"}}'))
    job_id = on_postgres.client.post("/v1/jobs", files=[*files(capture), spec]).raise_for_status().json()["id"]
    while on_postgres.job(job_id)["state"] == "queued":
        time.sleep(0.02)
    postgres.control("-m", "immediate", "restart")
    deadline_s = time.monotonic() + 120
    while (answer := on_postgres.client.get(f"/v1/jobs/{job_id}")).status_code == 503 or (
        answer.raise_for_status().json()["state"] in {"queued", "running"}
    ):
        assert time.monotonic() < deadline_s, answer.text
        time.sleep(0.2)
    assert answer.json()["state"] == "succeeded", answer.text
    assert on_postgres.downloads(job_id) == digests(tmp_path)
    assert on_postgres.client.delete(answer.json()["urls"]["session"]).status_code == 204


def test_tables_are_in_postgresql(on_postgres: Served, postgres: Postgres) -> None:
    assert not (on_postgres.data_dir / "multicap.db").exists()
    engine = sa.create_engine(sa.make_url(postgres.url).set(drivername="postgresql+psycopg"))
    with engine.connect() as connection:
        names = connection.scalars(sa.text("SELECT tablename FROM pg_tables WHERE schemaname = 'public'")).all()
    engine.dispose()
    assert {"sessions", "jobs", "chunks"} <= set(names)
