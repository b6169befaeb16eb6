"""Processes that detect for a live capture: one that is ended from outside does not end the capture."""

import threading
from collections.abc import Callable
from concurrent.futures import Executor, Future
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from types import TracebackType
from typing import Any

from pipeline.core.runtime.child_processes import ProcessPool

# Processes that are ended again and again have no room here.
_MOST_STARTS = 6


class DetectorPool(Executor):
    """Pool of processes, to be used in a ``with`` block, that is started again when one of them is killed.

    What was being computed is computed again. After six starts ``BrokenProcessPool`` is raised.

    Parameters
    ----------
    make
        Starts a pool.
    tell
        Called with a sentence, by any thread, when the pool is started again.
    """

    def __init__(self, make: Callable[[], ProcessPool], tell: Callable[[str], None]) -> None:
        self._make, self._tell = make, tell
        self._lock = threading.Lock()
        self._pool, self._num_starts = make(), 1

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        with self._lock:
            self._num_starts = _MOST_STARTS  # no more
            self._pool.__exit__(kind, error, traceback)

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Schedule a call."""
        found: Future[Any] = Future()
        self._submit(found, partial(fn, *args, **kwargs))
        return found

    def _submit(self, found: Future[Any], call: Callable[[], Any]) -> None:
        pool = self._pool
        try:
            pool.submit(call).add_done_callback(partial(self._take, pool, found, call))
        except RuntimeError:  # the pool is broken, or was replaced meanwhile
            self._submit_again(pool, found, call)

    def _take(self, pool: ProcessPool, found: Future[Any], call: Callable[[], Any], done: Future[Any]) -> None:
        """Pass a result on; of a process that was killed there is none."""
        if done.cancelled():
            found.cancel()
        elif isinstance(error := done.exception(), BrokenProcessPool):
            # Not in this thread, which is the pool's own and ends with it.
            threading.Thread(target=self._submit_again, args=(pool, found, call), daemon=True).start()
        elif error is not None:
            found.set_exception(error)
        else:
            found.set_result(done.result())

    def _submit_again(self, pool: ProcessPool, found: Future[Any], call: Callable[[], Any]) -> None:
        with self._lock:
            if self._pool is pool:
                if self._num_starts >= _MOST_STARTS:
                    found.set_exception(BrokenProcessPool("processes were ended again and again"))
                    return
                pool.__exit__(BrokenProcessPool, None, None)
                self._pool = self._make()
                self._num_starts += 1
                self._tell(
                    "A process that detects was ended from outside, most likely for lack of memory. It is started "
                    "again; meanwhile frames are dropped."
                )
        self._submit(found, call)
