"""Live capture from cameras: streams, detection in the newest pictures, people and their skeletons."""

import contextlib
import itertools
import math
import queue
import statistics
import time
from collections import deque
from collections.abc import Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass

from pipeline.calibration.sizes import fit_to_video
from pipeline.core.data.cameras import Camera
from pipeline.core.data.turns import upright_size_px
from pipeline.core.errors import InputError, Problem
from pipeline.core.joints import JointSet
from pipeline.core.options.config import MotionChoices
from pipeline.core.problems.session_codes import SIZE_MISMATCH
from pipeline.detection.entries import detection_joints, mark_offsets
from pipeline.detection.models import verify
from pipeline.detection.upright import turn_of_roll
from pipeline.run.live.cameras import detector_pool
from pipeline.run.live.cameras.feed import (
    CameraFeed,
    FeedEnded,
    FeedEvent,
    FeedOpened,
    FrameDecoded,
    PictureReady,
    SharedPictures,
)
from pipeline.run.live.cameras.offsets import OffsetSearch
from pipeline.run.live.cameras.pace import DetectionPace, frames_in_slot
from pipeline.run.live.cameras.sources import CameraSource
from pipeline.run.live.cameras.totals import CameraTotals, LiveTotals
from pipeline.run.live.capture import LiveCapture
from pipeline.run.live.records import DetectedFrame, LiveInstant
from pipeline.run.live.settings import LiveSettings
from pipeline.video.orientation import mirrored

# Time in which the rates of streams are measured.
_MEASURED_S = 1.0
# Rates of cameras that are believed; others are errors of a stream.
_MIN_RATE_HZ, _MAX_RATE_HZ, _USUAL_RATE_HZ = 1.0, 240.0, 25.0
# Measured rates within this share of the stated one are taken as that.
_SAME_RATE = 0.05
_MAX_MEASURED = 500
# Passes over the first pictures; the last one is measured.
_NUM_PASSES = 3
# Share of the time of the processors that is left for decoding and tracking.
_REST = 0.2
# Files start this long after all is ready.
_START_S = 0.1
_TICK_S = 1.0
# Least time between two pictures of a camera in which colours are measured: more tell no more, and cost time.
_COLOURS_S = 0.08
# Frames of the other cameras are waited for as many periods; at least as long as usual.
_WINDOW_PERIODS, _WINDOW_S = 2.5, 0.1


class LiveListener:
    """Listener of a live capture from cameras; what it does not override, it ignores."""

    def begin(self, cameras: Sequence[Camera], joints: JointSet, frame_rate_hz: float) -> None:
        """All cameras are open; the instants have this rate."""

    def take(self, camera: Camera, frame: DetectedFrame) -> None:
        """Bodies were detected in a frame of a camera; its time is that since the start."""

    def show(self, instant: LiveInstant, latency_s: float) -> None:
        """An instant is final; its time is that since the start."""

    def tell(self, sentence: str) -> None:
        """Something has changed that a person should know."""

    def tick(self, totals: LiveTotals) -> None:
        """A second has passed."""

    def end(self, totals: LiveTotals) -> None:
        """The capture is over."""


@dataclass(slots=True)
class _Ticket:
    """Frame whose bodies are being detected."""

    slot: int
    time_s: float
    pictures: SharedPictures
    bodies: "Future[detector_pool.DetectedBodies]"


class CameraRun:
    """Live capture from cameras.

    - ``cameras``: calibrated cameras in the order of the sources.
    - ``sources``: source of each camera.
    - ``choices``: choices of the networks.
    - ``sync_s``: length of the beginning from which the offsets of the cameras' clocks are found; ``None``: they are in
      step.
    - Raises ``ModelError`` if a network is not installed.
    """

    def __init__(
        self,
        cameras: Sequence[Camera],
        sources: Sequence[CameraSource],
        choices: MotionChoices,
        listener: LiveListener,
        sync_s: float | None = None,
    ) -> None:
        for name in choices.networks.names:
            verify(name)
        self._cameras, self._sources, self._choices = list(cameras), sources, choices
        self._sync_s, self._listener, self.joints = sync_s, listener, detection_joints(choices)
        self._events: queue.SimpleQueue[FeedEvent | None] = queue.SimpleQueue()
        self._sentences: queue.SimpleQueue[str] = queue.SimpleQueue()
        self.num_processes = detector_pool.num_processes(len(sources))
        # A picture waits while each process works, and a camera may have as many pictures as it takes for that.
        self._max_pending = self.num_processes + 1
        num_slots = -(-self._max_pending // len(sources))
        self._free = [set(range(num_slots)) for _ in sources]
        self._asked: list[set[int]] = [set() for _ in sources]
        self._num_pending = 0
        self._coloured_s = [-math.inf] * len(sources)  # times of the latest pictures with colours
        self._tickets: list[deque[_Ticket]] = [deque() for _ in sources]
        self._opened: dict[int, FeedOpened] = {}
        # Times of the first frames, from which rates are measured.
        self._first_s: list[deque[float]] = [deque(maxlen=_MAX_MEASURED) for _ in sources]
        self._num_decoded = [0] * len(sources)
        self._over: set[int] = set()
        self._is_stopped = False
        self.totals = LiveTotals([CameraTotals(camera.name) for camera in cameras])

    def stop(self) -> None:
        """End the capture soon; to be called by a handler of signals, or by another thread."""
        self._is_stopped = True
        self._events.put(None)

    def tell(self, sentence: str) -> None:
        """Have the listener told of something; may be called by any thread."""
        self._sentences.put(sentence)
        self._events.put(None)

    def run(self, pool: Executor) -> None:
        """Run to the end of all files, or until ``stop``.

        Raises ``InputError``: with the problems of all cameras that can't be opened, or whose pictures don't fit the
        calibration.
        """
        feeds = [
            CameraFeed(number, source, self._cameras[number].size_px, len(self._free[number]), self._events)
            for number, source in enumerate(self._sources)
        ]
        try:
            self._open()
            if not self._is_stopped:
                self._run(feeds, pool)
        finally:
            for feed in feeds:
                feed.close()
            for feed in feeds:
                feed.join()

    def _open(self) -> None:
        """Wait until each stream has begun, or has failed, and fit the calibration to the pictures."""
        problems: dict[int, Problem] = {}
        while len(self._opened.keys() | problems.keys()) < len(self._sources) and not self._is_stopped:
            match self._events.get():
                case FeedOpened(number) as opened:
                    self._opened[number] = opened
                case FeedEnded(number, Problem() as problem):
                    problems.setdefault(number, problem)
        for number, opened in self._opened.items():
            camera, form = self._cameras[number], opened.format
            fitted = fit_to_video(camera, form.shown_size_px, form.rotation_deg, form.stored_size_px, form.is_mirrored)
            if fitted is None:
                problems[number] = _size_problem(camera, opened, self._sources[number])
            else:
                self._cameras[number] = fitted[0]
                if fitted[1]:
                    self._listener.tell(f"{camera.name}: {fitted[1]}.")
                if form.is_mirrored:
                    self._listener.tell(f"{camera.name}: {mirrored().message}")
        if problems:
            raise InputError([problems[number] for number in sorted(problems)])
        self._turns_deg = [turn_of_roll(camera) or 0.0 for camera in self._cameras]
        self._sizes = [
            detector_pool.PictureSize(self._choices, upright_size_px(camera.size_px, turn_deg))
            for camera, turn_deg in zip(self._cameras, self._turns_deg, strict=True)
        ]

    def _run(self, feeds: Sequence[CameraFeed], pool: Executor) -> None:
        detections_hz = self._measure_detection(feeds, pool)
        if self._is_stopped:
            return
        end_s = time.monotonic() + 2 * _MEASURED_S
        streams = [number for number, source in enumerate(self._sources) if source.kind != "file"]
        while time.monotonic() < end_s and not self._is_stopped and not all(map(self._has_rate, streams)):
            with contextlib.suppress(queue.Empty):
                self._note_start(self._events.get(timeout=end_s - time.monotonic()))
        rates_hz = [self._rate_hz(number) for number in range(len(self._sources))]
        rate_hz = max(rates_hz)
        every = frames_in_slot(rate_hz, len(feeds), (1 - _REST) * detections_hz)
        period_s = every / rate_hz
        settings = LiveSettings(1 / period_s, window_s=max(_WINDOW_S, _WINDOW_PERIODS * period_s))
        capture = LiveCapture(self._cameras, self.joints, settings, mark_offsets(self._choices))
        search = OffsetSearch(self._cameras, self.joints, self._sync_s)
        self.totals.frame_rate_hz = settings.frame_rate_hz
        self._listener.begin(self._cameras, self.joints, settings.frame_rate_hz)
        if every > 1:
            self._listener.tell(
                f"The cameras send {rate_hz:.4g} Hz; this machine detects {detections_hz / len(feeds):.3g} Hz: every "
                f"{_ordinal(every)} frame is used."
            )
        start_s = time.monotonic() + _START_S
        for feed in feeds:
            feed.start(start_s)
        pace = DetectionPace(len(feeds), start_s, rate_hz, every)
        next_tick_s, counted = start_s + _TICK_S, (0, 0)
        while not self._is_stopped and not (len(self._over) == len(feeds) and not self._num_pending):
            try:
                event = self._events.get(timeout=max(0.0, next_tick_s - time.monotonic()))
            except queue.Empty:
                event = None
            self._handle(event, pace, pool)
            while not self._sentences.empty():
                self._listener.tell(self._sentences.get())
            self._take_detected(capture, search, start_s)
            if search.advance(time.monotonic() - start_s, pool):
                self._tell_offsets(search)
            self._ask(feeds, pace)
            if time.monotonic() >= next_tick_s:
                next_tick_s += _TICK_S
                self.totals.duration_s = time.monotonic() - start_s
                before, counted = counted, self.totals.num_frames
                if pace.judge(counted[0] - before[0], counted[1] - before[1]):
                    which = "every frame" if pace.every == 1 else f"every {_ordinal(pace.every)} frame of each camera"
                    self._listener.tell(f"By the speed of this machine, {which} is used from now on.")
                self._listener.tick(self.totals)
        self.totals.duration_s = time.monotonic() - start_s
        if search.offsets_s is None:
            self._listener.tell("The capture ended before the offsets were found: no person was captured.")
        for instant in capture.flush():
            self._show(instant, start_s)

    def _measure_detection(self, feeds: Sequence[CameraFeed], pool: Executor) -> float:
        """Pictures that the processes detect in a second, by the first picture of each camera."""
        for feed in feeds:
            feed.ask(0)
        ready: list[PictureReady] = []
        while len(ready) < len(feeds) and not self._is_stopped:
            if isinstance(event := self._events.get(), PictureReady):
                ready.append(event)
            self._note_start(event)
        num_jobs, durations_s = max(len(ready), self.num_processes), [1.0]
        for _ in range(_NUM_PASSES) if ready else ():
            jobs = [self._job(picture) for picture in itertools.islice(itertools.cycle(ready), num_jobs)]
            futures = [pool.submit(detector_pool.detect_bodies, job) for job in jobs]
            for job_number, future in enumerate(futures):
                self._sizes[ready[job_number % len(ready)].camera].add(future.result().spans_px)
            durations_s = [future.result().duration_s for future in futures]
        return self.num_processes / statistics.median(durations_s)

    def _has_rate(self, number: int) -> bool:
        times_s = self._first_s[number]
        return len(times_s) > 1 and times_s[-1] - times_s[0] >= _MEASURED_S

    def _rate_hz(self, number: int) -> float:
        stated_hz, times_s = self._opened[number].rate_hz, self._first_s[number]
        rate_hz = stated_hz
        if self._has_rate(number):
            measured_hz = 1 / max(
                statistics.median(after - before for before, after in itertools.pairwise(times_s)), 1e-3
            )
            if abs(measured_hz / max(stated_hz, 1e-3) - 1) > _SAME_RATE:
                rate_hz = measured_hz
        return rate_hz if _MIN_RATE_HZ <= rate_hz <= _MAX_RATE_HZ else _USUAL_RATE_HZ

    def _note_start(self, event: FeedEvent | None) -> None:
        """Take an event before the capture begins; a stream that ends now is as one that can't be opened."""
        match event:
            case FrameDecoded(camera, number, time_s):
                self._first_s[camera].append(time_s)
                self._num_decoded[camera] = number
            case FeedEnded(_, Problem() as problem):
                raise InputError([problem])

    def _handle(self, event: FeedEvent | None, pace: DetectionPace, pool: Executor) -> None:
        match event:
            case FrameDecoded(camera, number, time_s):
                totals = self.totals.cameras[camera]
                totals.decoded += number - self._num_decoded[camera]
                self._num_decoded[camera] = number
                pace.announce(camera, time_s)
            case PictureReady(camera, slot, time_s) if slot in self._asked[camera]:
                self._asked[camera].remove(slot)
                pace.take(camera, time_s)
                bodies = pool.submit(detector_pool.detect_bodies, self._job(event))
                bodies.add_done_callback(lambda _: self._events.put(None))
                self._tickets[camera].append(_Ticket(slot, time_s, event.pictures, bodies))
            case FeedOpened(camera):
                self._opened[camera], self._num_decoded[camera] = event, 0
                self.totals.cameras[camera].state = "open"
                self._listener.tell(f"{self.totals.cameras[camera].name} is open again.")
            case FeedEnded(camera, problem, is_over):
                self._end(camera, problem, is_over)

    def _end(self, camera: int, problem: Problem | None, is_over: bool) -> None:
        totals = self.totals.cameras[camera]
        if is_over:
            self._over.add(camera)
        if problem is None:
            totals.state = "ended"
            return
        # Pictures that were asked for never come.
        asked = self._asked[camera]
        self._num_pending -= len(asked)
        self._free[camera] |= asked
        asked.clear()
        if totals.state == "open":
            totals.state, totals.lost = ("ended" if is_over else "lost"), totals.lost + 1
            again = "" if is_over else " It is opened again as soon as it answers."
            self._listener.tell(f"{totals.name} is lost: {problem.message}{again}")

    def _ask(self, feeds: Sequence[CameraFeed], pace: DetectionPace) -> None:
        """Ask for pictures as long as people can be detected in them; of a slot of several frames for all at once."""
        max_pending = self._max_pending if pace.every == 1 else max(self._max_pending, len(feeds))
        while self._num_pending < max_pending:
            free = [
                number
                for number, slots in enumerate(self._free)
                if slots and self.totals.cameras[number].state != "lost"
            ]
            if (camera := pace.choose(free)) is None:
                return
            slot = self._free[camera].pop()
            self._asked[camera].add(slot)
            self._num_pending += 1
            feeds[camera].ask(slot)

    def _tell_offsets(self, search: OffsetSearch) -> None:
        found = zip(self._cameras, search.offsets_s or (), strict=True)
        self._listener.tell(f"Offsets: {', '.join(f'{camera.name} {offset_s:+.3f} s' for camera, offset_s in found)}.")
        for frame in search.frames:
            self._listener.take(self._cameras[frame.camera], search.moved(frame))
        search.frames.clear()

    def _take_detected(self, capture: LiveCapture, search: OffsetSearch, start_s: float) -> None:
        """Pass on the bodies that were detected, of each camera in the order of its frames."""
        for camera, tickets in enumerate(self._tickets):
            while tickets and tickets[0].bodies.done():
                ticket = tickets.popleft()
                bodies = ticket.bodies.result()
                self._sizes[camera].add(bodies.spans_px)
                self._free[camera].add(ticket.slot)
                self._num_pending -= 1
                self.totals.cameras[camera].detected += 1
                time_s = ticket.time_s - start_s
                if time_s < 0.0:
                    continue
                frame = DetectedFrame(camera, time_s, bodies.keypoints_px, bodies.score, bodies.colour)
                if search.offsets_s is None:
                    search.add(frame)
                    continue
                frame = search.moved(frame)
                self._listener.take(self._cameras[camera], frame)
                for instant in capture.push(*frame):
                    self._show(instant, start_s)

    def _show(self, instant: LiveInstant, start_s: float) -> None:
        totals = self.totals
        latency_s = time.monotonic() - start_s - instant.time_s
        totals.instants += 1
        totals.people = max([totals.people, *(person.id for person in instant.people)])
        totals.latencies.add(latency_s)
        self._listener.show(instant, latency_s)

    def _job(self, picture: PictureReady) -> detector_pool.DetectionJob:
        """Detection in a picture, which the calibration turns upright."""
        number, pictures = picture.camera, picture.pictures
        form, turn_deg = self._opened[number].format, self._turns_deg[number]
        measures_colours = self._choices.appearance == "on" and picture.time_s >= self._coloured_s[number] + _COLOURS_S
        if measures_colours:
            self._coloured_s[number] = picture.time_s
        return detector_pool.DetectionJob(
            self._choices,
            pictures.path,
            pictures.shape,
            picture.slot,
            form.rotation_deg,
            turn_deg,
            self._sizes[number].sizes,
            measures_colours,
            form.is_mirrored,
        )


def _size_problem(camera: Camera, opened: FeedOpened, source: CameraSource) -> Problem:
    width, height = opened.format.shown_size_px
    message = f"The pictures have {width} x {height} pixels, the calibration {camera.size_px[0]} x {camera.size_px[1]}."
    hint = "Calibrate at the size of the stream, or set the camera to the calibrated size."
    return Problem(SIZE_MISMATCH, message, file=source.shown, camera=camera.name, hint=hint)


def _ordinal(number: int) -> str:
    return {2: "2nd", 3: "3rd"}.get(number, f"{number}th")
