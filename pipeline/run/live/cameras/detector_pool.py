"""Detection of bodies in the newest pictures, in processes that open the networks once.

A process that is ended from outside does not end the capture.
"""

import os
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Executor, Future
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from types import TracebackType
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, UInt8

from pipeline.core.options.config import MotionChoices
from pipeline.core.runtime.child_processes import ProcessPool
from pipeline.detection.appearance import colour_histograms
from pipeline.detection.profiles.profile_detector import open_detection
from pipeline.detection.profiles.sizes import RULES, USUAL_PX, CameraSizes, SizeRule, body_spans_px, choose_sizes
from pipeline.detection.providers.find import current_provider
from pipeline.video.rotation import Rotator

# Below the processes that decode, which must not fall behind.
_NICE = 5
# Processes that a camera keeps busy: 60 Hz and networks of 65 ms.
_MOST_BUSY = 4
# Pictures by which a size is chosen.
_NUM_LATEST = 50


class DetectionJob(NamedTuple):
    """Picture in which bodies are to be detected."""

    choices: MotionChoices  # Choices of the networks
    path: str  # File of the pictures
    shape: tuple[int, int, int, int]  # Number of pictures, height, width and channels
    slot: int  # Number of the picture in the file
    rotation_deg: int  # Counterclockwise turn of the picture for display, after ``is_mirrored``
    turn_deg: float  # Counterclockwise turn that brings the shown picture upright
    sizes: CameraSizes | None  # Size of the picture in the network's input; ``None``: the usual one
    measures_colours: bool  # True if the colours of the clothes are measured
    is_mirrored: bool = False  # True if left and right of the picture are exchanged for display


class DetectedBodies(NamedTuple):
    """Bodies in a picture."""

    keypoints_px: Float[np.ndarray, "bodies joints 2"]  # NaN where a joint was not found
    score: Float[np.ndarray, "bodies joints"]
    colour: UInt8[np.ndarray, "bodies parts bins"] | None  # Colours of the clothes; ``None``: not measured
    spans_px: Float[np.ndarray, " bodies"]  # Size of each body, see ``body_spans_px``
    duration_s: float  # Time that the detection took: of a core, which other programs don't lengthen, or of the GPU


def num_processes(num_cameras: int) -> int:
    """Number of processes that detect: one on a GPU, else one for each processor, but no more than can be busy."""
    return 1 if current_provider().is_gpu else min(os.cpu_count() or 1, _MOST_BUSY * num_cameras)


def start_detecting(choices: MotionChoices) -> None:
    """Open the networks in this process, which yields to others."""
    os.nice(_NICE)
    open_detection(choices.networks, choices.detected_joints)


def detect_bodies(job: DetectionJob) -> DetectedBodies:
    """Detect the bodies in a picture, and measure the colours of their clothes if they are asked for."""
    clock = time.perf_counter if current_provider().is_gpu else time.thread_time
    started_s = clock()
    pictures = np.memmap(job.path, np.uint8, "r", shape=job.shape)
    image_rgb = Rotator()(pictures[job.slot], job.rotation_deg // 90, job.is_mirrored)
    detector = open_detection(job.choices.networks, job.choices.detected_joints, job.sizes, job.turn_deg)
    bodies = detector.detect(image_rgb)
    colour = None
    if job.measures_colours:
        colour = colour_histograms(image_rgb, bodies.keypoints_px, bodies.score, detector.joints)
    spans_px = body_spans_px(bodies, job.turn_deg)
    return DetectedBodies(bodies.keypoints_px, bodies.score, colour, spans_px, clock() - started_s)


class PictureSize:
    """Size of a camera's pictures in the network's input, by the people in the latest pictures.

    The rule is the same as for finished sessions, but for one pass that is at most as large as the usual one: what is
    found out about people must not make the detection slower than it was measured at the start.

    ``size_px``: width and height of the upright pictures.
    """

    def __init__(self, choices: MotionChoices, size_px: tuple[int, int]) -> None:
        rule = RULES[choices.profile]
        self._rule = SizeRule(rule.span_px, min(rule.max_px, USUAL_PX)) if choices.networks.is_sized else None
        self._size_px = size_px
        self._spans_px: deque[Float[np.ndarray, " bodies"]] = deque(maxlen=_NUM_LATEST)
        self._num_until_choice = 1
        self.sizes: CameraSizes | None = None

    def add(self, spans_px: Float[np.ndarray, " bodies"]) -> None:
        """Take the bodies of a picture; choose the size by the first one, and again after many."""
        self._spans_px.append(spans_px)
        self._num_until_choice -= 1
        if self._num_until_choice == 0 and self._rule is not None:
            self._num_until_choice = _NUM_LATEST
            chosen = choose_sizes(list(self._spans_px), self._size_px, self._rule)
            self.sizes = CameraSizes(chosen.scaled_px[-1:])


# Processes that are ended again and again have no room here.
_MOST_STARTS = 6


class DetectorPool(Executor):
    """Pool of processes, to be used in a ``with`` block, that is started again when one of them is killed.

    What was being computed is computed again. After six starts ``BrokenProcessPool`` is raised.

    ``make``: starts a pool. ``tell``: called with a sentence, by any thread, when the pool is started again.
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
