import pytest
import sqlalchemy as sa

from pipeline.core.options.providers import CPU, Provider
from tests.worker.store.conftest import StoreBench
from worker.store.database.tables import workers
from worker.store.errors import UnknownSchema
from worker.store.model.work import WorkerState, WorkerStatus
from worker.store.repositories.work.workers import provider_at_work, shared_by_ready

STARTING = WorkerStatus("host:1", WorkerState.STARTING, "A worker compiles", 3, 75)
READY = WorkerStatus(
    "host:2",
    WorkerState.READY,
    "A worker works",
    detectors=("movenet-multipose", "other"),
    bodies=("human",),
    formats=("bvh", "usd"),
)


def seen_ago(jobs: StoreBench, seconds: float) -> None:
    jobs.execute(sa.update(workers).values(seen_at=workers.c.seen_at - seconds))


def test_workers_are_listed_as_they_last_reported(jobs: StoreBench) -> None:
    jobs.store.workers.report(READY)
    jobs.store.workers.report(STARTING)
    assert jobs.store.workers.all() == [STARTING, READY]
    further = WorkerStatus("host:1", WorkerState.STARTING, "A worker compiles", 4, 75)
    jobs.store.workers.report(further)
    assert jobs.store.workers.all() == [further, READY]
    jobs.store.workers.remove(["host:1"])
    assert jobs.store.workers.all() == [READY]


@pytest.mark.parametrize("seconds", [11.0, -11.0])
def test_worker_silent_is_gone_also_after_clock_set_back(jobs: StoreBench, seconds: float) -> None:
    jobs.store.workers.report(READY)
    seen_ago(jobs, seconds)
    assert jobs.store.workers.all() == []
    seen_ago(jobs, 6 * seconds)
    jobs.store.workers.report(STARTING)
    engine = sa.create_engine(jobs.url)
    with engine.connect() as connection:
        assert connection.execute(sa.select(workers.c.id)).scalars().all() == ["host:1"]
    engine.dispose()


def test_worker_starting_knows_no_detectors(jobs: StoreBench) -> None:
    assert shared_by_ready([], "detectors") is None
    assert shared_by_ready([STARTING], "detectors") is None
    assert shared_by_ready([STARTING, READY], "detectors") == frozenset({"movenet-multipose", "other"})


def test_detector_is_installed_if_every_worker_has_it() -> None:
    # Any of them may take a chunk.
    other = WorkerStatus("elsewhere:1", WorkerState.READY, "A worker works", detectors=("movenet-multipose",))
    assert shared_by_ready([READY, other], "detectors") == frozenset({"movenet-multipose"})


def test_body_is_installed_if_every_worker_has_it() -> None:
    assert shared_by_ready([STARTING], "bodies") is None
    assert shared_by_ready([STARTING, READY], "bodies") == frozenset({"human"})
    other = WorkerStatus("elsewhere:1", WorkerState.READY, "A worker works", detectors=("other",))
    assert shared_by_ready([READY, other], "bodies") == frozenset()


def test_format_is_written_if_every_worker_can() -> None:
    assert shared_by_ready([STARTING], "formats") is None
    assert shared_by_ready([STARTING, READY], "formats") == frozenset({"bvh", "usd"})
    other = WorkerStatus("elsewhere:1", WorkerState.READY, "A worker works", formats=("bvh",))
    assert shared_by_ready([READY, other], "formats") == frozenset({"bvh"})


def test_worker_refuses_newer_database(jobs: StoreBench) -> None:
    jobs.store.require_known_schema()
    jobs.execute(sa.text("UPDATE alembic_version SET version_num = '0099'"))
    with pytest.raises(UnknownSchema, match="0099"):
        jobs.store.require_known_schema()


GPU, SLOWER = Provider("cuda", "1.31.1", "NVIDIA H200"), Provider("openvino", "1.8.1", note="")


def with_provider(number: int, provider: Provider, state: WorkerState = WorkerState.READY) -> WorkerStatus:
    return WorkerStatus(f"host:{number}", state, "A worker works", provider=provider)


def test_providers_of_workers_are_listed_as_they_were_reported(jobs: StoreBench) -> None:
    fallback = Provider(note="Networks run on the CPU, not by cuda: there is no driver.")
    for number, provider in enumerate((GPU, fallback)):
        jobs.store.workers.report(with_provider(number, provider))
    assert [worker.provider for worker in jobs.store.workers.all()] == [GPU, fallback]


@pytest.mark.parametrize(
    ("workers_", "earlier", "expected"),
    [
        ([], None, ""),
        ([with_provider(1, CPU)], None, ""),
        ([with_provider(1, CPU), with_provider(2, GPU)], None, "cuda 1.31.1"),
        ([with_provider(1, CPU), with_provider(2, GPU)], "", ""),
        ([with_provider(1, CPU), with_provider(2, SLOWER)], None, ""),
        ([with_provider(1, SLOWER)], "cuda 1.31.1", "openvino 1.8.1"),
        ([with_provider(1, CPU), with_provider(2, GPU, WorkerState.STARTING)], None, ""),
    ],
)
def test_work_is_planned_for_provider_that_ready_worker_has(
    workers_: list[WorkerStatus], earlier: str | None, expected: str
) -> None:
    """A GPU comes first, and a job that was begun goes on with its own as long as a worker has it."""
    assert provider_at_work(workers_, earlier) == expected
