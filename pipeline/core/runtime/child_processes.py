"""Child processes that run Multicap's own code: commands and a process pool. Imports the standard library only.

``python -m`` and ``python -c`` put the current directory first on the search path of modules, where a ``numpy.py``
would replace NumPy. Multicap starts its child processes without the current directory on their search path.
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

# Prefix of module names: `multicap.` in the wheel, empty in a checkout. See `hatch_build.py`.
_PARENT = __name__.removesuffix("pipeline.core.runtime.child_processes")


def python_command(*arguments: str) -> list[str]:
    """Build the command that runs this interpreter without the current directory on its search path."""
    return [sys.executable, "-P", *arguments]


def module_command(module: str, *arguments: str) -> list[str]:
    """Build the command that runs a module of Multicap as a program, ``python -m``.

    ``module`` is its name in a checkout, such as ``pipeline.capture.preflight``.
    """
    return python_command("-m", _PARENT + module, *arguments)


class ProcessPool(ProcessPoolExecutor):
    """Pool of spawned processes, to be used in a ``with`` block.

    If the block raises an error or is interrupted, the processes are killed at once. Ctrl-C in a terminal reaches the
    parent process only. Processes end by themselves if their parent is killed. Each of at most ``num_processes`` calls
    ``initializer`` with ``initargs`` first.
    """

    def __init__(
        self, num_processes: int, initializer: Callable[..., object] | None = None, initargs: Sequence[Any] = ()
    ) -> None:
        # multiprocessing starts children by ``python -c`` without options. The variable has no effect on this process,
        # which has started already.
        os.environ["PYTHONSAFEPATH"] = "1"
        # In a file: a pipe takes 64 KiB, and the parent would wait with Ctrl-C blocked until each child has loaded its
        # modules.
        self._first = tempfile.NamedTemporaryFile(prefix="multicap-")  # noqa: SIM115 - closed with the pool
        pickle.dump((initializer, initargs), self._first)
        self._first.flush()
        context = multiprocessing.get_context("spawn")
        super().__init__(num_processes, mp_context=context, initializer=_start, initargs=(self._first.name,))

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Schedule a call; start a process if none is idle."""
        with uninterrupted():
            return super().submit(fn, *args, **kwargs)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if kind is not None:
            # As ``kill_workers`` of Python 3.14; otherwise the shutdown would wait for running calls.
            for process in list((self._processes or {}).values()):
                process.kill()
        self.shutdown(wait=True, cancel_futures=True)
        self._first.close()


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Delay SIGINT and SIGTERM while processes or threads are started, so that none of them is left without an owner.

    Processes that are started in the block never get SIGINT, because they inherit the blocked signal.
    """
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    # The signal may reach another thread; its handler would run in the main thread.
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
        initializer, initargs = pickle.load(file)  # noqa: S301 - written by the parent, readable by the user only
    if initializer is not None:
        initializer(*initargs)


def _end_with_parent() -> None:
    if (parent := multiprocessing.parent_process()) is not None:
        parent.join()
        os._exit(1)
