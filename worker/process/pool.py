"""Celery's pool of forked processes with a faster shutdown."""

from typing import Any

from billiard.pool import CLOSE, RUN
from celery.concurrency.prefork import TaskPool


class PromptPool(TaskPool):  # type: ignore[misc]  # Celery has no types
    """Pool that ends as soon as its last process has ended.

    Celery's own pool acknowledges messages from a thread while it ends, and checks twice a second whether it has ended.
    A message without an acknowledgement is delivered again and announces work once more, which does no harm here.
    """

    _pool: Any

    def on_stop(self) -> None:
        """Wait until the processes have returned their chunks and ended."""
        if self._pool is not None and self._pool._state in {RUN, CLOSE}:
            self._pool.close()
            self._pool.join()
            self._pool = None
