"""Queue of messages that wake workers; the database holds the work."""

from celery import Celery
from kombu.exceptions import OperationalError
from opentelemetry import trace
from opentelemetry.propagate import inject
from opentelemetry.trace import SpanKind

QUEUE_NAME = "multicap"
TASK_NAME = "multicap.work"

_TIMEOUT_S = 2.0

_tracer = trace.get_tracer("multicap")


class WorkQueue:
    """Publisher of messages to the broker.

    Parameters
    ----------
    broker_url
        Celery's broker URL.
    """

    def __init__(self, broker_url: str) -> None:
        self._celery = Celery(broker=broker_url, set_as_current=False)
        self._celery.conf.update(
            task_ignore_result=True,
            broker_connection_timeout=_TIMEOUT_S,
            broker_transport_options={
                "socket_timeout": _TIMEOUT_S,
                "socket_connect_timeout": _TIMEOUT_S,
                "max_retries": 0,
            },
        )

    def publish(self) -> bool:
        """Wake a worker. ``False`` if the broker does not answer: the reaper wakes a worker later."""
        with _tracer.start_as_current_span("publish", kind=SpanKind.PRODUCER):
            headers: dict[str, str] = {}
            inject(headers)
            try:
                self._celery.send_task(TASK_NAME, queue=QUEUE_NAME, headers=headers, retry=False)
            except (OperationalError, OSError):
                return False
            return True

    def ping(self) -> bool:
        """Whether the broker answers."""
        try:
            with self._celery.connection_for_write() as connection:
                connection.ensure_connection(max_retries=0, timeout=_TIMEOUT_S)
        except (OperationalError, OSError):
            return False
        return True

    def close(self) -> None:
        """Close the connections."""
        self._celery.close()
