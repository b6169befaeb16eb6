"""Celery's pool of forked processes, with an end that takes no longer than they do."""

from typing import Any

from billiard.pool import CLOSE, RUN
from celery.concurrency.prefork import TaskPool


class PromptPool(TaskPool):  # type: ignore[misc]  # Celery has no types
    """Pool that ends with its last process.

    Celery acknowledges messages from a thread while its pool ends, and looks twice a second whether it has. A message
    that stays without an acknowledgement says once more that there is work, which does no harm here.
    """

    _pool: Any

    def on_stop(self) -> None:
        """Wait until the processes have given back their chunks and ended."""
        if self._pool is not None and self._pool._state in {RUN, CLOSE}:
            self._pool.close()
            self._pool.join()
            self._pool = None
