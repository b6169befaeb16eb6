"""Metrics of recordings of this process."""

from prometheus_client import CollectorRegistry, Counter, Gauge

_PREFIX = "multicap"


class RecordingMetrics:
    """Open connections of phones and hosts, their ends by problems, and thumbnails."""

    def __init__(self, registry: CollectorRegistry) -> None:
        self.open = Gauge(
            "recording_connections",
            "Open connections of recordings, of phones and hosts.",
            ("side",),
            namespace=_PREFIX,
            registry=registry,
        )
        self._ended = Counter(
            "recording_connections_ended",
            "Connections of recordings that ended, by the problem; without one: ended.",
            ("code",),
            namespace=_PREFIX,
            registry=registry,
        )
        self._thumbnails = Counter(
            "recording_thumbnails",
            "Thumbnails of phones that were shown, or dropped because they came too fast.",
            ("outcome",),
            namespace=_PREFIX,
            registry=registry,
        )
        for side in ("phone", "host"):
            self.open.labels(side)

    def ended(self, code: str | None) -> None:
        """Count the end of a connection by its problem; ``None``: without one."""
        self._ended.labels(code or "ended").inc()

    def thumbnail(self, outcome: str) -> None:
        """Count a thumbnail: ``shown`` or ``dropped``."""
        self._thumbnails.labels(outcome).inc()
