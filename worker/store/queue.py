"""Queues of messages that wake workers; the database holds the work."""

from enum import StrEnum
from typing import Any

from celery import Celery
from kombu.exceptions import OperationalError
from opentelemetry import trace
from opentelemetry.propagate import inject
from opentelemetry.trace import SpanKind
from redis.exceptions import RedisError

from worker.store import outages

TASK_NAME = "multicap.work"


class Queue(StrEnum):
    """Queue of Celery. A worker receives messages for all workers, and those for workers of its own kind."""

    ALL = "multicap"
    GPU = "multicap.gpu"
    CPU = "multicap.cpu"


_TIMEOUT_S = 2.0
_CONNECT_TIMEOUT_S = 5.0
# Idle time after which a connection is tested before it is used.
_HEALTH_CHECK_S = 10

_tracer = trace.get_tracer("multicap")


def transport_options(timeout_s: float) -> dict[str, Any]:
    """Options of connections to the broker; one that died silently is noticed in seconds, and replaced.

    ``timeout_s`` is for connecting, and for an answer.
    """
    return {
        "socket_timeout": timeout_s,
        "socket_connect_timeout": min(timeout_s, _CONNECT_TIMEOUT_S),
        "socket_keepalive": True,
        "socket_keepalive_options": dict(outages.SOCKET_OPTIONS),
        "health_check_interval": _HEALTH_CHECK_S,
    }


class WorkQueue:
    """Publisher of messages to the broker. ``broker_url`` is Celery's."""

    def __init__(self, broker_url: str) -> None:
        self._celery = Celery(broker=broker_url, set_as_current=False)
        self._celery.conf.update(
            task_ignore_result=True,
            broker_connection_timeout=_TIMEOUT_S,
            broker_transport_options={**transport_options(_TIMEOUT_S), "max_retries": 0},
        )

    def publish(self, queue: Queue = Queue.ALL) -> bool:
        """Wake a worker that receives a queue's messages.

        ``False`` if the broker does not answer: the reaper wakes a worker later.
        """
        with _tracer.start_as_current_span("publish", kind=SpanKind.PRODUCER):
            headers: dict[str, str] = {}
            inject(headers)
            try:
                self._celery.send_task(TASK_NAME, queue=queue, headers=headers, retry=False)
            except (OperationalError, OSError):
                return False
            return True

    def ping(self) -> bool:
        """True if the broker answers."""
        try:
            # On a connection of the pool that ``publish`` uses.
            with self._celery.producer_pool.acquire(block=True, timeout=_TIMEOUT_S) as producer:
                producer.connection.ensure_connection(max_retries=0, timeout=_TIMEOUT_S)
                return bool(producer.connection.default_channel.client.ping())
        except (OperationalError, RedisError, OSError):
            return False

    def close(self) -> None:
        """Close the connections."""
        self._celery.close()
