"""Metrics of live captures of this process."""

import time

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram

_PREFIX = "multicap"
_SECONDS = (0.002, 0.005, 0.01, 0.02, 0.03, 0.05, 0.1, 0.2, 0.5, 1.0, 5.0)


class LiveMetrics:
    """Open, refused and ended captures, what they received, sent and dropped, and their latency."""

    def __init__(self, registry: CollectorRegistry) -> None:
        self.open = Gauge("live_captures", "Open live captures.", namespace=_PREFIX, registry=registry)
        self._refused = _counter("live_captures_refused", "Live captures that were not opened.", "code", registry)
        self._ended = _counter(
            "live_captures_ended", "Live captures that ended; without a problem: ended.", "code", registry
        )
        self.frames = Counter("live_frames", "Frames that clients sent.", namespace=_PREFIX, registry=registry)
        self.instants = Counter("live_instants", "Instants that were sent.", namespace=_PREFIX, registry=registry)
        self._dropped = _counter(
            "live_dropped", "Frames and instants that were dropped because a side was too slow.", "kind", registry
        )
        self._latency = Histogram(
            "live_latency_seconds",
            "Seconds from the arrival of the frame that makes an instant final until the instant is sent.",
            namespace=_PREFIX,
            buckets=_SECONDS,
            registry=registry,
        )
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


def _counter(name: str, text: str, label: str, registry: CollectorRegistry) -> Counter:
    return Counter(name, text, (label,), namespace=_PREFIX, registry=registry)
