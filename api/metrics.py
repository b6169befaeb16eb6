"""Figures for Prometheus: of this process's requests, and of all jobs, which the database knows.

Every replica of the API says the same of jobs: ask one, or take the largest.
"""

from collections.abc import Iterator

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from worker.jobs.database.totals import Total
from worker.jobs.files.disk import DiskSpace
from worker.jobs.store import JobStore

_PREFIX = "multicap"
_SECONDS = (0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 10.0, 60.0, 600.0)
# What a sum's label says, and what the sum is of.
_TOTALS = {
    Total.LEASES_LOST: ("stage", "Chunks whose worker fell silent."),
    Total.CHUNKS_DONE: ("stage", "Chunks that were worked on and finished."),
    Total.CHUNKS_REUSED: ("stage", "Chunks whose output was there already."),
    Total.CHUNKS_RETRIED: ("stage", "Chunks that were given another try."),
    Total.CHUNK_SECONDS: ("stage", "Time that finished chunks took, from their first try on."),
    Total.CHUNK_UNITS: ("stage", "Units of work (a camera's frames in the stage detect) of finished chunks."),
    Total.JOBS_ENDED: ("state", "Jobs that came to an end."),
}


class RequestMetrics:
    """How many requests there were, and how long they took, by route."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        labels = ("method", "route", "status")
        self._requests = Counter("http_requests", "Requests.", labels, namespace=_PREFIX, registry=self.registry)
        self._seconds = Histogram(
            "http_request_seconds",
            "Seconds from a request's first byte to its answer's last.",
            ("method", "route"),
            namespace=_PREFIX,
            buckets=_SECONDS,
            registry=self.registry,
        )
        self._free_bytes = Gauge(
            "disk_free_bytes", "Room on the disk of the data folder.", namespace=_PREFIX, registry=self.registry
        )
        self._headroom_bytes = Gauge(
            "disk_headroom_bytes", "Room that is kept free there.", namespace=_PREFIX, registry=self.registry
        )

    def count(self, method: str, route: str, status: int, seconds: float) -> None:
        """Count a request. ``route`` is a path with names in the places of ids."""
        self._requests.labels(method, route, str(status)).inc()
        self._seconds.labels(method, route).observe(seconds)

    def expose(self, store: JobStore, disk: DiskSpace) -> bytes:
        """Everything in Prometheus' text format."""
        self._free_bytes.set(disk.free_bytes)
        self._headroom_bytes.set(disk.headroom_bytes)
        of_jobs = CollectorRegistry()
        of_jobs.register(_JobCollector(store))
        return generate_latest(self.registry) + generate_latest(of_jobs)


class _JobCollector(Collector):
    def __init__(self, store: JobStore) -> None:
        self._store = store

    def describe(self) -> list[Metric]:
        """Nothing beforehand: it would ask the database."""
        return []

    def collect(self) -> Iterator[Metric]:
        """Ask the database."""
        figures = self._store.figures()
        for total, (label, text) in _TOTALS.items():
            family = CounterMetricFamily(f"{_PREFIX}_{total}", text, labels=(label,))
            for (name, value_of), value in sorted(figures.totals.items()):
                if name == total:
                    family.add_metric((value_of,), value)
            yield family
        for name, text, by_state in (
            ("jobs", "Jobs that there are.", figures.jobs),
            ("chunks", "Unfinished chunks of unfinished jobs.", figures.chunks),
        ):
            gauge = GaugeMetricFamily(f"{_PREFIX}_{name}", text, labels=("state",))
            for state, number in sorted(by_state.items()):
                gauge.add_metric((state,), number)
            yield gauge
        longest = "How long the first job in the queue has been there."
        yield GaugeMetricFamily(f"{_PREFIX}_longest_queued_seconds", longest, figures.longest_queued_s)
