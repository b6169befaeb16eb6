"""Metrics of the service, of live captures and of recordings."""

import time
from collections.abc import Iterator, Sequence
from typing import Any

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from worker.store.database.totals import Total
from worker.store.files.disk import DiskSpace
from worker.store.model.work import RunningChunk
from worker.store.store import JobStore

_PREFIX = "multicap"
_LIVE_SECONDS = (0.002, 0.005, 0.01, 0.02, 0.03, 0.05, 0.1, 0.2, 0.5, 1.0, 5.0)


class LiveMetrics:
    """Open, refused and ended captures, what they received, sent and dropped, and their latency."""

    def __init__(self, registry: CollectorRegistry) -> None:
        known = _known_to(registry)
        self.open = Gauge("live_captures", "Open live captures.", **known)
        self._refused = Counter("live_captures_refused", "Live captures that were not opened.", ("code",), **known)
        text = "Live captures that ended; without a problem: ended."
        self._ended = Counter("live_captures_ended", text, ("code",), **known)
        self.frames = Counter("live_frames", "Frames that clients sent.", **known)
        self.instants = Counter("live_instants", "Instants that were sent.", **known)
        text = "Frames and instants that were dropped because a side was too slow."
        self._dropped = Counter("live_dropped", text, ("kind",), **known)
        text = "Seconds from the arrival of the frame that makes an instant final until the instant is sent."
        self._latency = Histogram("live_latency_seconds", text, buckets=_LIVE_SECONDS, **known)
        for kind in ("frame", "instant"):
            self._dropped.labels(kind)

    def refused(self, code: str) -> None:
        """Count a capture that was not opened, by its problem."""
        self._refused.labels(code).inc()

    def ended(self, code: str | None) -> None:
        """Count the end of a capture by its problem; ``None``: without one."""
        self._ended.labels(code or "ended").inc()

    def dropped(self, kind: str, number: int) -> None:
        """Count dropped messages: ``frame`` or ``instant``."""
        self._dropped.labels(kind).inc(number)

    def sent(self, since_s: float) -> None:
        """Count an instant that was sent; ``since_s`` is when its last frame came, by the monotonic clock."""
        self.instants.inc()
        self._latency.observe(time.monotonic() - since_s)


def _known_to(registry: CollectorRegistry) -> dict[str, Any]:
    return {"namespace": _PREFIX, "registry": registry}


class RecordingMetrics:
    """Open connections of phones and hosts, their ends by problems, and thumbnails."""

    def __init__(self, registry: CollectorRegistry) -> None:
        known = _known_to(registry)
        text = "Open connections of recordings, of phones and hosts."
        self.open = Gauge("recording_connections", text, ("side",), **known)
        text = "Connections of recordings that ended, by the problem; without one: ended."
        self._ended = Counter("recording_connections_ended", text, ("code",), **known)
        text = "Thumbnails of phones that were shown, or dropped because they came too fast."
        self._thumbnails = Counter("recording_thumbnails", text, ("outcome",), **known)
        for side in ("phone", "host"):
            self.open.labels(side)

    def ended(self, code: str | None) -> None:
        """Count the end of a connection by its problem; ``None``: without one."""
        self._ended.labels(code or "ended").inc()

    def thumbnail(self, outcome: str) -> None:
        """Count a thumbnail: ``shown`` or ``dropped``."""
        self._thumbnails.labels(outcome).inc()


_SECONDS = (0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 10.0, 60.0, 600.0)
# Chunks that have run for less time are no metrics: they would make new labels every few seconds.
_LONG_S = 60.0
# Label and help text of each sum.
_TOTALS = {
    Total.LEASES_LOST: ("stage", "Chunks whose worker stopped responding."),
    Total.CHUNKS_DONE: ("stage", "Chunks that a worker finished."),
    Total.CHUNKS_REUSED: ("stage", "Chunks whose output existed already."),
    Total.CHUNKS_RETRIED: ("stage", "Chunks that were tried again."),
    Total.CHUNKS_GIVEN_BACK: ("stage", "Chunks that were given back because of an outage."),
    Total.CHUNK_SECONDS: ("stage", "Seconds from the first attempt to the end of finished chunks."),
    Total.CHUNK_UNITS: ("stage", "Units of work (a camera's frames in the stage detect) of finished chunks."),
    Total.JOBS_ENDED: ("state", "Jobs that ended."),
}


class RequestMetrics:
    """Counts and durations of requests by route, and of live captures."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        known, labels = _known_to(self.registry), ("method", "route", "status")
        self._requests = Counter("http_requests", "Requests.", labels, **known)
        text = "Seconds from the first byte of the request to the last byte of the response."
        self._seconds = Histogram("http_request_seconds", text, labels[:2], buckets=_SECONDS, **known)
        self.live, self.recordings = LiveMetrics(self.registry), RecordingMetrics(self.registry)
        self._free_bytes = Gauge("disk_free_bytes", "Free bytes on the disk of the data folder.", **known)
        text = "Bytes that are kept free on the disk of the data folder."
        self._headroom_bytes = Gauge("disk_headroom_bytes", text, **known)

    def count(self, method: str, route: str, status: int, seconds: float) -> None:
        """Count a request. ``route`` is the path template, such as ``/v1/jobs/{job_id}``."""
        self._requests.labels(method, route, str(status)).inc()
        self._seconds.labels(method, route).observe(seconds)

    def expose(self, store: JobStore, disk: DiskSpace) -> bytes:
        """All metrics in Prometheus' text format."""
        self._free_bytes.set(disk.free_bytes)
        self._headroom_bytes.set(disk.headroom_bytes)
        of_jobs = CollectorRegistry()
        of_jobs.register(_JobCollector(store))
        return generate_latest(self.registry) + generate_latest(of_jobs)


class _JobCollector(Collector):
    def __init__(self, store: JobStore) -> None:
        self._store = store

    def describe(self) -> list[Metric]:
        """Describe no metrics in advance: that would query the database."""
        return []

    def collect(self) -> Iterator[Metric]:
        """Read the figures of jobs from the database."""
        figures = self._store.figures()
        for total, (label, text) in _TOTALS.items():
            family = CounterMetricFamily(f"{_PREFIX}_{total}", text, labels=(label,))
            for (name, label_value), value in sorted(figures.totals.items()):
                if name == total:
                    family.add_metric((label_value,), value)
            yield family
        for name, text, by_state in (
            ("jobs", "Jobs by state.", figures.jobs),
            ("chunks", "Unfinished chunks of unfinished jobs.", figures.chunks),
        ):
            gauge = GaugeMetricFamily(f"{_PREFIX}_{name}", text, labels=("state",))
            for state, number in sorted(by_state.items()):
                gauge.add_metric((state,), number)
            yield gauge
        longest = "Waiting time of the first job in the queue."
        yield GaugeMetricFamily(f"{_PREFIX}_longest_queued_seconds", longest, figures.longest_queued_s)
        yield from _of_running_chunks(figures.running)


def _of_running_chunks(running: Sequence[RunningChunk]) -> Iterator[Metric]:
    """Oldest running chunk, and the one that has not moved for longest: no more, as each has labels of its own."""
    running = [chunk for chunk in running if chunk.age_s >= _LONG_S]
    oldest = max(running, key=lambda chunk: chunk.age_s, default=None)
    stillest = max(running, key=lambda chunk: chunk.still_s, default=None)
    for name, text, chunk, value in (
        ("oldest_chunk_seconds", "Running time of the oldest chunk.", oldest, oldest.age_s if oldest else 0.0),
        ("oldest_chunk_progress", "Share of it that is done, 0 to 1.", oldest, oldest.progress if oldest else 0.0),
        ("stillest_chunk_seconds", "Longest time without progress.", stillest, stillest.still_s if stillest else 0.0),
    ):
        gauge = GaugeMetricFamily(f"{_PREFIX}_{name}", text, labels=("tenant", "job_id", "stage", "chunk"))
        if chunk is not None:
            gauge.add_metric((chunk.tenant, chunk.job_id, chunk.stage, str(chunk.index)), value)
        yield gauge
