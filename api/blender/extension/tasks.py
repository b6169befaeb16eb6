"""Work in a thread, followed from Blender's main thread, which never waits for it."""

import threading
import time
from collections.abc import Callable
from typing import Any

from api.blender.extension.answers import RequestError
from api.blender.extension.client import StoppedTaskError


class BackgroundTask:
    """Function in a thread of its own, which reports how far it is and can be stopped.

    The function gets the task, calls ``report`` now and then, and touches nothing of Blender. A thread that waits for a
    silent service ends some time after ``stop``; nothing waits for it, and what it still returns is dropped.

    ``title``: title of the work for the user, such as ``Send a capture``.
    """

    def __init__(self, title: str, work: Callable[["BackgroundTask"], Any]) -> None:
        self.title = title
        self.fraction: float | None = None  # Share that is done; ``None`` if it is not known
        self.text = ""  # Words for the present step
        self.result: Any = None
        self.error: str = ""  # Sentence about why it came to nothing
        self._stopped = threading.Event()
        self._work = work
        self._thread = threading.Thread(target=self._run, name=title, daemon=True)

    def start(self) -> "BackgroundTask":
        """Start the thread."""
        self._thread.start()
        return self

    @property
    def is_over(self) -> bool:
        """True after the end of the function, and as soon as the task is stopped."""
        return self._stopped.is_set() or not self._thread.is_alive()

    @property
    def is_stopped(self) -> bool:
        """True after ``stop``."""
        return self._stopped.is_set()

    def stop(self) -> None:
        """Stop the task at its next report."""
        self._stopped.set()

    def join(self, timeout_s: float) -> bool:
        """Wait for the thread; return whether it has ended."""
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def report(self, fraction: float | None, text: str | None = None) -> None:
        """Say from the thread how far it is. Raises ``StoppedTaskError`` after ``stop``."""
        if self._stopped.is_set():
            raise StoppedTaskError
        self.fraction = fraction
        if text is not None:
            self.text = text

    def sleep(self, pause_s: float) -> None:
        """Wait in the thread. Raises ``StoppedTaskError`` after ``stop``."""
        if self._stopped.wait(pause_s):
            raise StoppedTaskError

    def _run(self) -> None:
        try:
            self.result = self._work(self)
        except StoppedTaskError:
            self._stopped.set()
        except RequestError as error:
            self.error = str(error)
        except OSError as error:
            self.error = f"A file can't be read or written: {error.strerror or error}."
        except Exception as error:  # nothing above a thread catches it, and the user must learn of it
            self.error = f"The extension failed: {type(error).__name__}."


class Speed:
    """Progress of bytes in words, with the speed since the start."""

    def __init__(self, num_bytes: int) -> None:
        self._num_bytes, self._start_s = num_bytes, time.monotonic()

    def fraction(self, done: float) -> float:
        """Share that is done."""
        return done / self._num_bytes if self._num_bytes else 1.0

    def text(self, done: float) -> str:
        """Bytes that are done, of all, and the speed.

        >>> Speed(2_000_000).text(0.0)
        '0.0 of 2.0 MB'
        """
        took_s = time.monotonic() - self._start_s
        shown = f"{done / 1e6:.1f} of {self._num_bytes / 1e6:.1f} MB"
        return f"{shown}, {done / 1e6 / took_s:.1f} MB/s" if took_s > 1.0 and done else shown
