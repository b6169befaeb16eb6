"""Child processes that run Multicap's own code; standard library only, so that every package may import it.

Python puts the current directory in front of its search path for ``python -m`` and ``python -c``; a ``numpy.py`` there
would be imported instead of NumPy. Multicap starts its children without the current directory on their search path.
"""

import multiprocessing
import os
import pickle
import signal
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any

# The wheel holds the packages inside of `multicap`; empty in a checkout. See `hatch_build.py`.
_PARENT = __name__.removesuffix("pipeline.runtime.child_processes")


def python_command(*arguments: str) -> list[str]:
    """Command that runs this interpreter without the current directory on its search path."""
    return [sys.executable, "-P", *arguments]


def module_command(module: str, *arguments: str) -> list[str]:
    """Command that runs a module of Multicap as a program, ``python -m``.

    Parameters
    ----------
    module
        Its name in a checkout, such as ``pipeline.capture.preflight``.
    """
    return python_command("-m", _PARENT + module, *arguments)


class ProcessPool(ProcessPoolExecutor):
    """Pool of fresh processes, to be used in a ``with`` block.

    At an error in the block, or an interruption of it, the processes are killed at once. A terminal's Ctrl-C reaches
    the parent only. Processes whose parent was killed end by themselves.

    Parameters
    ----------
    num_processes
        How many processes at most.
    initializer, initargs
        Function that each process calls first, and its arguments.
    """

    def __init__(
        self, num_processes: int, initializer: Callable[..., object] | None = None, initargs: Sequence[Any] = ()
    ) -> None:
        # multiprocessing starts children by ``python -c``, and takes no options for them. For this process itself the
        # variable comes too late to mean anything.
        os.environ["PYTHONSAFEPATH"] = "1"
        # By a file: a pipe takes 64 KiB, and the parent, deaf to Ctrl-C, would wait for each child to load its modules.
        self._first = tempfile.NamedTemporaryFile(prefix="multicap-")  # noqa: SIM115 - closed with the pool
        pickle.dump((initializer, initargs), self._first)
        self._first.flush()
        context = multiprocessing.get_context("spawn")
        super().__init__(num_processes, mp_context=context, initializer=_start, initargs=(self._first.name,))

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Schedule a call; starts a process if none is idle."""
        with uninterrupted():
            return super().submit(fn, *args, **kwargs)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if kind is not None:
            # As ``kill_workers`` of Python 3.14; without it everybody waits for the work at hand.
            for process in list((self._processes or {}).values()):
                process.kill()
        self.shutdown(wait=True, cancel_futures=True)
        self._first.close()


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Hold SIGINT and SIGTERM back while processes or threads are started, lest one be left that nobody knows.

    Processes that are started meanwhile never get SIGINT, not even while Python loads: they inherit that it is blocked.
    """
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    # Another thread may get the signal all the same; its handler would run in the main thread.
    came: list[int] = []
    is_main = threading.current_thread() is threading.main_thread()
    numbers = (signal.SIGINT, signal.SIGTERM) if is_main else ()
    handlers = {number: signal.signal(number, lambda number, _: came.append(number)) for number in numbers}
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for interrupt in came:
            signal.raise_signal(interrupt)


def _start(first: str) -> None:
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with Path(first).open("rb") as file:
        initializer, initargs = pickle.load(file)  # noqa: S301 - the parent's, which nobody else may write
    if initializer is not None:
        initializer(*initargs)


def _end_with_parent() -> None:
    if (parent := multiprocessing.parent_process()) is not None:
        parent.join()
        os._exit(1)
