"""Lists, searches and claims beside 10,000 sessions and 100,000 jobs on PostgreSQL.

``make load`` runs it: times are those of an API process that a client calls over loopback, one request after another.
``test_no_query_reads_more_rows_than_page_needs`` asks PostgreSQL how many rows each query of a request reads.
"""

import contextlib
import json
import os
import random
import re
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

import httpx2
import numpy as np
import pytest
import sqlalchemy as sa

from pipeline.core.runtime.parent_watch import tied_to_parent
from tests.load.many_jobs import NUM_JOBS, NUM_SESSIONS, ManyJobs, fill
from tests.postgres import running_postgres
from tests.waiting import wait_for
from worker.store.model.states import JobState

pytestmark = pytest.mark.load

NUM_REQUESTS = int(os.environ.get("MULTICAP_LOAD_REQUESTS", "200"))
MAX_P99_MS = 50.0


@pytest.fixture(scope="module")
def many(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[ManyJobs, str]]:
    with running_postgres() as server:
        started_s = time.monotonic()
        filled = fill(server.url)
        print(f"{NUM_SESSIONS} sessions, {NUM_JOBS} jobs written in {time.monotonic() - started_s:.0f} s")  # noqa: T201
        yield filled, server.url
        filled.engine.dispose()
        filled.store.close()


@pytest.fixture(scope="module")
def url(many: tuple[ManyJobs, str], tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Address of an API process on the database."""
    folder = tmp_path_factory.mktemp("api")
    with socket.create_server(("127.0.0.1", 0)) as listening:
        fd, port = listening.fileno(), listening.getsockname()[1]
        environment = os.environ | {
            "MULTICAP_DATA_DIR": str(folder),
            "MULTICAP_DATABASE_URL": many[1],
            "MULTICAP_MAX_TENANT_REQUESTS_PER_S": "100000",
        }
        command = tied_to_parent([sys.executable, "-P", "-m", "api", "--fd", str(fd)])
        with (
            (folder / "log").open("wb") as log,
            subprocess.Popen(command, env=environment, pass_fds=[fd], stdout=log, stderr=log) as process,
        ):
            address = f"http://127.0.0.1:{port}"
            wait_for(lambda: answers(address), timeout_s=120.0)
            yield address
            process.terminate()


def answers(address: str) -> bool:
    with contextlib.suppress(httpx2.TransportError):
        return bool(httpx2.get(f"{address}/healthz", trust_env=False, timeout=60.0).is_success)
    return False


def id_of(number: int, kind: int) -> str:
    return f"{number:08x}-0000-7000-8000-00000000000{kind}"


# Requests of the page and of scripts, with a random place.
REQUESTS: dict[str, Callable[[random.Random], str]] = {
    "jobs": lambda chance: "/v1/jobs",
    "jobs, a page further down": lambda chance: f"/v1/jobs?cursor={id_of(chance.randrange(NUM_JOBS), 1)}",
    "jobs that succeeded": lambda chance: "/v1/jobs?state=succeeded",
    "jobs that failed": lambda chance: "/v1/jobs?state=failed",
    "queued jobs": lambda chance: "/v1/jobs?state=queued",
    "jobs of a session": lambda chance: f"/v1/sessions/{id_of(10 * chance.randrange(NUM_SESSIONS // 10), 0)}/jobs",
    "sessions": lambda chance: "/v1/sessions",
    "sessions, a page further down": lambda chance: f"/v1/sessions?cursor={id_of(chance.randrange(NUM_SESSIONS), 0)}",
    "sessions by name": lambda chance: f"/v1/sessions?name={chance.choice(['dance', 'fight', 'ballet 1'])}",
    "sessions by a name that none has": lambda chance: "/v1/sessions?name=swimming",
    "sessions by the state of their newest job": lambda chance: "/v1/sessions?state=failed",
    "a job": lambda chance: f"/v1/jobs/{id_of(10 * chance.randrange(1, NUM_JOBS // 10), 1)}",
    "the last job in the queue": lambda chance: f"/v1/jobs/{id_of(NUM_JOBS, 1)}",
    "a caller's usage": lambda chance: "/v1/caller",
}


def test_lists_and_searches_answer_within_50_ms(url: str, many: tuple[ManyJobs, str]) -> None:
    chance = random.Random(0)  # noqa: S311 - no secret
    slow = {}
    with httpx2.Client(base_url=url, timeout=120.0, trust_env=False) as client:
        client.headers["Authorization"] = f"Bearer {many[0].keys['tenant-0']}"
        for name, path_of in REQUESTS.items():
            seconds = []
            for _ in range(NUM_REQUESTS + 5):
                path = path_of(chance)
                started_s = time.perf_counter()
                answer = client.get(path)
                seconds.append(time.perf_counter() - started_s)
                assert answer.status_code == 200, (path, answer.text)
            p50, p99 = np.percentile(np.array(seconds[5:]) * 1e3, [50, 99])
            print(f"{name}: median {p50:.1f} ms, p99 {p99:.1f} ms", flush=True)  # noqa: T201
            if p99 > MAX_P99_MS:
                slow[name] = round(float(p99), 1)
    assert slow == {}


def rows_read(engine: sa.Engine, statement: str, parameters: Any) -> int:
    """Rows that PostgreSQL reads from tables and indexes for a query, those that it filters out too."""
    with engine.connect() as connection:
        plan = connection.exec_driver_sql(f"EXPLAIN (ANALYZE, FORMAT JSON) {statement}", parameters).scalar()
    (root,) = plan if isinstance(plan, list) else json.loads(str(plan))

    def count(node: dict[str, Any]) -> float:
        read = 0.0
        if "Relation Name" in node or "Index Name" in node:
            removed = node.get("Rows Removed by Filter", 0) + node.get("Rows Removed by Index Recheck", 0)
            read = (node["Actual Rows"] + removed) * node["Actual Loops"]
        return read + sum(count(child) for child in node.get("Plans", ()))

    return round(count(root["Plan"]))


@contextlib.contextmanager
def queries(engine: sa.Engine) -> Iterator[list[tuple[str, Any]]]:
    """Queries of an engine during the block."""
    seen: list[tuple[str, Any]] = []

    def note(connection: Any, cursor: Any, statement: str, parameters: Any, *_: Any) -> None:
        if re.match(r"\s*(SELECT|WITH)", statement):
            seen.append((statement, parameters))

    sa.event.listen(engine, "before_cursor_execute", note)
    try:
        yield seen
    finally:
        sa.event.remove(engine, "before_cursor_execute", note)


def test_no_query_reads_more_rows_than_page_needs(many: tuple[ManyJobs, str]) -> None:
    filled, _ = many
    store, engine = filled.store.tenant("tenant-0"), filled.store._database._engine
    acts: dict[str, Callable[[], object]] = {
        "jobs": store.jobs.page,
        "queued jobs": lambda: store.jobs.page(state=JobState.QUEUED),
        "failed jobs": lambda: store.jobs.page(state=JobState.FAILED),
        "sessions": store.sessions.page,
        "sessions by state": lambda: store.sessions.page(state=JobState.FAILED),
        "sessions by name": lambda: store.sessions.page(name="ballet 1"),
        "usage": store.usage,
        "claim": lambda: filled.store.leases.claim("load", 60.0),
        "reap": lambda: filled.store.leases.reap(60.0),
        "figures": filled.store.figures,
    }
    read = {}
    for name, act in acts.items():
        with queries(engine) as seen:
            act()
        read[name] = (len(seen), sum(rows_read(filled.engine, *query) for query in list(seen)))
        print(f"{name}: {read[name][0]} queries, {read[name][1]} rows read", flush=True)  # noqa: T201
    for name in ("jobs", "queued jobs", "failed jobs", "sessions", "reap"):
        assert read[name][1] < 15_000, name
    # However long the queue is: a claim for each of its chunks would read it all.
    assert read["claim"][1] < 200
