"""Celery's pool of forked processes with a faster shutdown, and what its children must not keep of their parent."""

import os
import stat
from contextlib import suppress
from pathlib import Path
from typing import Any

from billiard.pool import CLOSE, RUN
from celery.concurrency.prefork import TaskPool

_LAST_STREAM = 2


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


def release_sockets_of_parent() -> None:
    """Put ``/dev/null`` in place of the sockets that this process, which was just forked, has of its parent.

    A child that replaces a lost one inherits the connections to the broker. As long as it holds one that both ends have
    closed since, as when the broker restarts, Linux reports it to the parent again and again, which then does nothing
    but ask. The numbers stay taken: objects of the parent that close them later close no file of this process.
    Standard streams stay, which may be sockets of a journal.
    """
    nothing = os.open(os.devnull, os.O_RDWR)
    for number in [int(entry.name) for entry in Path("/dev/fd").iterdir()]:
        with suppress(OSError):  # the folder itself was open
            if number > _LAST_STREAM and stat.S_ISSOCK(os.fstat(number).st_mode):
                os.dup2(nothing, number, inheritable=False)
    os.close(nothing)
