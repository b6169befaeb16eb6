"""Machines get the chunks of their cameras first, so that few of them fetch each video."""

from collections import Counter
from dataclasses import replace

import pytest

from tests.worker.store.conftest import CODE, LEASE_S, StoreBench
from tests.worker.store.repositories.work.test_workers import READY
from worker.store.model.work import ChunkPlan, StagePlan
from worker.store.repositories.work.affinity import cameras_of
from worker.store.spec import JobSpec

NUM_CAMERAS, NUM_RANGES = 4, 12


@pytest.fixture
def jobs_of_cameras(jobs: StoreBench) -> StoreBench:
    """A job whose chunks are ranges of all cameras, one range after the other, as plans have them."""
    pieces = [(number, camera) for number in range(NUM_RANGES) for camera in range(NUM_CAMERAS)]
    plan = tuple(
        ChunkPlan(index, {"camera": f"cam {camera}", "start_frame": number}, 1, f"detect-{number}-{camera}")
        for index, (number, camera) in enumerate(pieces)
    )
    jobs.store.jobs.add(jobs.session_id, JobSpec(), (StagePlan("detect", plan, CODE),))
    return jobs


def fetches(jobs: StoreBench, hosts: list[str], workers_a_host: int = 2) -> set[tuple[str, str]]:
    """Pairs of machines and cameras, of machines that take chunks in turns."""
    for host in hosts:
        jobs.store.workers.report(replace(READY, id=f"{host}:1"))
    pairs: set[tuple[str, str]] = set()
    counts: Counter[str] = Counter()
    names = [f"{host}:{number}" for host in hosts for number in range(workers_a_host)]
    while True:
        for name in names:
            claim = jobs.store.leases.claim(name, LEASE_S)
            if claim is None:
                assert sum(counts.values()) == NUM_CAMERAS * NUM_RANGES
                assert max(counts.values()) - min(counts.values()) <= 1  # nobody waited
                return pairs
            host = name.rpartition(":")[0]
            counts[name] += 1
            pairs.add((host, claim.payload["camera"]))
            jobs.finish(claim)


@pytest.mark.parametrize("num_hosts", [2, 4])
def test_each_video_is_fetched_by_one_machine(jobs_of_cameras: StoreBench, num_hosts: int) -> None:
    hosts = [f"host-{number}" for number in range(num_hosts)]
    assert len(fetches(jobs_of_cameras, hosts)) == NUM_CAMERAS


def test_a_machine_alone_takes_the_chunks_in_order(jobs_of_cameras: StoreBench) -> None:
    jobs_of_cameras.store.workers.report(replace(READY, id="host:1"))
    claims = [jobs_of_cameras.store.leases.claim("host:1", LEASE_S) for _ in range(5)]
    assert [claim.index for claim in claims if claim is not None] == [0, 1, 2, 3, 4]


def test_a_machine_without_ready_chunks_of_its_cameras_takes_others(jobs_of_cameras: StoreBench) -> None:
    for host in ("host-0", "host-1"):
        jobs_of_cameras.store.workers.report(replace(READY, id=f"{host}:1"))
    claims = [jobs_of_cameras.store.leases.claim("host-0:1", LEASE_S) for _ in range(NUM_CAMERAS * NUM_RANGES)]
    indices = [claim.index % NUM_CAMERAS for claim in claims if claim is not None]
    assert indices == [0, 2] * NUM_RANGES + [1, 3] * NUM_RANGES


@pytest.mark.parametrize("num_hosts", [1, 2, 3, 5, 9])
def test_every_camera_has_a_machine_and_shares_are_even(num_hosts: int) -> None:
    cameras = ["a", "b", "c", "d"]
    shares = [cameras_of(number, num_hosts, cameras) for number in range(num_hosts)]
    assert frozenset().union(*shares) == set(cameras)
    assert max(map(len, shares)) - min(map(len, shares)) <= 1
