"""Simulation of the queue: tenants, jobs, stages one after another, workers that fail.

It follows the rules of ``worker.store.repositories.work.fair_share``: a free worker takes a chunk of the tenant with
the fewest running ones, of its oldest job; a stage begins when the one before is done.
"""

import heapq
import random
from collections import Counter, deque
from collections.abc import Generator, Sequence
from dataclasses import dataclass, field
from typing import Any

import simpy


@dataclass(frozen=True, slots=True)
class StageLoad:
    """A stage of a simulated job."""

    num_chunks: int
    chunk_s: float  # Time of a chunk on a worker


@dataclass(frozen=True, slots=True)
class JobArrival:
    """A job that arrives."""

    tenant: str
    time_s: float
    stages: Sequence[StageLoad]


@dataclass(frozen=True, slots=True)
class Failures:
    """Failures of workers. A chunk of a lost worker is ready again when its lease has ended."""

    mean_s: float  # Mean time from a worker's start to its loss; exponential
    lease_s: float = 20.0
    restart_s: float = 30.0  # Time until the worker takes chunks again


@dataclass(slots=True)
class _Job:
    number: int  # In the order of arrivals
    arrival: JobArrival
    stage: int = 0
    ready: int = 0
    unfinished: int = 0
    is_begun: bool = False


@dataclass(slots=True)
class QueueOutcome:
    """Outcome of a simulation."""

    response_s: list[float] = field(default_factory=list)  # Of each job, from its arrival to its end
    waiting_s: list[float] = field(default_factory=list)  # Of each job, until its first chunk begins
    busy_s: float = 0.0  # Of all workers
    end_s: float = 0.0  # End of the last job
    lost_chunks: int = 0
    work: list[tuple[float, str, float]] = field(default_factory=list)  # Chunks: end, tenant, seconds


class _Cluster:
    """Jobs at work, and the workers that wait for chunks."""

    def __init__(self, environment: simpy.Environment, chance: random.Random, gap_s: float) -> None:
        self.environment, self.chance, self.gap_s = environment, chance, gap_s
        self.ready: dict[str, list[tuple[int, _Job]]] = {}  # Jobs with ready chunks by tenant: heaps, oldest first
        self.running: Counter[str] = Counter()
        self.idle: deque[simpy.Event] = deque()
        self.outcome = QueueOutcome()

    def begin(self, job: _Job, num_chunks: int) -> None:
        """Make chunks of a job ready, and wake as many workers."""
        if job.ready == 0:
            heapq.heappush(self.ready.setdefault(job.arrival.tenant, []), (job.number, job))
        job.ready += num_chunks
        for _ in range(min(num_chunks, len(self.idle))):
            self.idle.popleft().succeed()

    def arrive(self, arrivals: Sequence[JobArrival]) -> Generator[Any, Any, None]:
        for number, arrival in enumerate(sorted(arrivals, key=lambda arrival: arrival.time_s)):
            yield self.environment.timeout(arrival.time_s - self.environment.now)
            first = arrival.stages[0].num_chunks
            self.begin(_Job(number, arrival, unfinished=first), first)

    def take(self, last_turns: dict[str, int]) -> _Job | None:
        """Take a ready chunk: of the tenant with the fewest running ones, in turns of the worker among equals."""
        tenants = [tenant for tenant, jobs in self.ready.items() if jobs]
        if not tenants:
            return None
        self.chance.shuffle(tenants)
        tenant = min(tenants, key=lambda tenant: (self.running[tenant], last_turns.get(tenant, 0)))
        last_turns[tenant] = max(last_turns.values(), default=0) + 1
        job = self.ready[tenant][0][1]
        if not job.is_begun:
            job.is_begun = True
            self.outcome.waiting_s.append(self.environment.now - job.arrival.time_s)
        job.ready -= 1
        if job.ready == 0:
            heapq.heappop(self.ready[tenant])
        self.running[tenant] += 1
        return job

    def finish(self, job: _Job, seconds: float) -> None:
        tenant, now_s = job.arrival.tenant, self.environment.now
        self.running[tenant] -= 1
        self.outcome.work.append((now_s, tenant, seconds))
        job.unfinished -= 1
        if job.unfinished:
            return
        job.stage += 1
        if job.stage < len(job.arrival.stages):
            job.unfinished = job.arrival.stages[job.stage].num_chunks
            self.begin(job, job.unfinished)
            return
        self.outcome.response_s.append(now_s - job.arrival.time_s)
        self.outcome.end_s = now_s

    def work(self, failures: Failures | None) -> Generator[Any, Any, None]:
        """One worker, for ever."""
        alive_s = _lifetime_s(self.chance, failures)
        last_turns: dict[str, int] = {}
        while True:
            job = self.take(last_turns)
            if job is None:
                woken = self.environment.event()
                self.idle.append(woken)
                yield woken
                continue
            seconds = job.arrival.stages[job.stage].chunk_s
            if failures is not None and alive_s < seconds:
                yield self.environment.timeout(alive_s)
                self.outcome.busy_s += alive_s
                self.outcome.lost_chunks += 1
                self.environment.process(self.give_back(job, failures.lease_s))
                yield self.environment.timeout(failures.restart_s)
                alive_s = _lifetime_s(self.chance, failures)
                continue
            yield self.environment.timeout(seconds)
            alive_s -= seconds
            self.outcome.busy_s += seconds
            self.finish(job, seconds)
            yield self.environment.timeout(self.gap_s)

    def give_back(self, job: _Job, lease_s: float) -> Generator[Any, Any, None]:
        """Make the chunk of a lost worker ready again when its lease has ended."""
        yield self.environment.timeout(lease_s)
        self.running[job.arrival.tenant] -= 1
        self.begin(job, 1)


def simulate(
    arrivals: Sequence[JobArrival],
    num_workers: int,
    gap_s: float = 0.0,
    failures: Failures | None = None,
    seed: int = 0,
) -> QueueOutcome:
    """Simulate until all jobs have ended.

    Parameters
    ----------
    arrivals
        All jobs.
    num_workers
        Worker processes.
    gap_s
        Time from the end of a worker's chunk to the begin of its next one: claims, and reports of what was done.
    failures
        How workers are lost; ``None``: never.
    seed
        Seed of all that is random.
    """
    environment = simpy.Environment()
    chance = random.Random(seed)  # noqa: S311 - no secret
    cluster = _Cluster(environment, chance, gap_s)
    environment.process(cluster.arrive(arrivals))
    for _ in range(num_workers):
        environment.process(cluster.work(failures))
    while len(cluster.outcome.response_s) < len(arrivals):
        environment.step()
    return cluster.outcome


def _lifetime_s(chance: random.Random, failures: Failures | None) -> float:
    return float("inf") if failures is None else chance.expovariate(1.0 / failures.mean_s)
