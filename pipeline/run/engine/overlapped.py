"""Tasks of a stage in two threads of a process: while one is in a network, the other decodes and prepares pictures.

One network runs at a time (``pipeline.detection.network``), so that a process still computes networks on one core. In
one thread decoding and Python would add half of the networks' time.
"""

from collections.abc import Callable, Generator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from queue import SimpleQueue

from pipeline.core.runtime.child_processes import uninterrupted
from pipeline.run.engine.stage import Task

# With a third, two would wait for the network; each has a decoder and a picture in memory.
_AT_ONCE = 2


class _UnwantedError(Exception):
    """End of a task whose output is not wanted any more."""


def overlapped(
    tasks: Sequence[Task], run: Callable[[Task, Callable[[], None]], object], on_unit: Callable[[Task], None]
) -> Generator[Task, None, None]:
    """Run tasks, two at a time; yields each one when it is done.

    Close the generator if it is not read to its end: that ends the tasks at their next unit, and waits for them.

    ``run``: runs a task in a thread, and calls a function after each of its units. ``on_unit``: called with the task
    after each unit, in the thread that reads the generator. Raises ``Exception``: error of the first of the tasks that
    fails, as if they ran one after the other. Later ones are ended.
    """
    events = SimpleQueue[tuple[int, Future[object] | None]]()
    num_wanted = len(tasks)
    error: BaseException | None = None

    def start(number: int) -> None:
        def count() -> None:
            if number >= num_wanted:
                raise _UnwantedError
            events.put((number, None))

        with uninterrupted():  # signals are for the thread that reads the generator
            future = pool.submit(run, tasks[number], count)
        future.add_done_callback(lambda future: events.put((number, future)))

    with ThreadPoolExecutor(_AT_ONCE) as pool:
        try:
            num_started = min(_AT_ONCE, len(tasks))
            for number in range(num_started):
                start(number)
            num_running = num_started
            while num_running:
                number, future = events.get()
                if future is None:
                    on_unit(tasks[number])
                    continue
                num_running -= 1
                if (failure := future.exception()) is not None:
                    if number < num_wanted:
                        num_wanted, error = number, failure
                    continue
                if num_started < num_wanted:
                    start(num_started)
                    num_started, num_running = num_started + 1, num_running + 1
                if error is None:
                    yield tasks[number]
        finally:
            num_wanted = 0
    if error is not None:
        raise error
