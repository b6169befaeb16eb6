"""Files and terminal of `multicap live`: each listens to the capture."""

import csv
import io
import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import IO, Any

from rich.status import Status

from api.cli.console import console, writing
from pipeline.calibration.write import encode
from pipeline.capture.keypoint_files.writing import encode_frame
from pipeline.core.data.cameras import Camera
from pipeline.core.errors import PipelineError
from pipeline.core.joints import JointSet
from pipeline.run.live.cameras.listeners import ready_document
from pipeline.run.live.cameras.run import LiveListener
from pipeline.run.live.cameras.totals import LiveTotals
from pipeline.run.live.packing import instant_json
from pipeline.run.live.records import DetectedFrame, LiveInstant
from worker.store.files.disk import append_whole


class ListenerGroup(LiveListener):
    """Several listeners as one.

    A listener that fails during the capture, such as a file on a full disk, is left out, the others are told, and its
    error is one of ``errors``. The error of the last one is raised.
    """

    def __init__(self, listeners: Iterable[LiveListener] = ()) -> None:
        self._listeners = list(listeners)
        self.errors: list[PipelineError] = []

    def add(self, listener: LiveListener) -> None:
        """Add a listener, before the capture begins."""
        self._listeners.append(listener)

    def begin(self, cameras: Sequence[Camera], joints: JointSet, frame_rate_hz: float) -> None:
        """See ``LiveListener``."""
        for listener in self._listeners:
            listener.begin(cameras, joints, frame_rate_hz)

    def take(self, camera: Camera, frame: DetectedFrame) -> None:
        """See ``LiveListener``."""
        self._each(lambda listener: listener.take(camera, frame))

    def show(self, instant: LiveInstant, latency_s: float) -> None:
        """See ``LiveListener``."""
        self._each(lambda listener: listener.show(instant, latency_s))

    def tell(self, sentence: str) -> None:
        """See ``LiveListener``."""
        self._each(lambda listener: listener.tell(sentence))

    def tick(self, totals: LiveTotals) -> None:
        """See ``LiveListener``."""
        self._each(lambda listener: listener.tick(totals))

    def end(self, totals: LiveTotals) -> None:
        """See ``LiveListener``."""
        self._each(lambda listener: listener.end(totals))

    def _each(self, call: Callable[[LiveListener], None]) -> None:
        for listener in tuple(self._listeners):
            if listener not in self._listeners:  # it has failed when it was told of another one
                continue
            try:
                call(listener)
            except PipelineError as error:
                self._listeners.remove(listener)
                if not self._listeners:
                    raise
                self.errors.append(error)
                self.tell(f"{error} The capture continues without it.")


class JsonLines(LiveListener):
    """Lines of JSON in an open file: ``ready``, an ``instant`` each, ``notice`` in between."""

    def __init__(self, file: IO[str]) -> None:
        self._file, self._sequence = file, 0

    def begin(self, cameras: Sequence[Camera], joints: JointSet, frame_rate_hz: float) -> None:
        """Write the names, and the time at which the capture begins."""
        started_at = datetime.now(UTC).isoformat(timespec="milliseconds")
        self._write(ready_document(cameras, joints, frame_rate_hz) | {"started_at": started_at})

    def show(self, instant: LiveInstant, latency_s: float) -> None:
        """Write an instant."""
        document = instant_json(instant, self._sequence)
        self._write({"type": "instant", **document, "latency_s": round(latency_s, 4)})
        self._sequence += 1

    def tell(self, sentence: str) -> None:
        """Write what has changed."""
        self._write({"type": "notice", "message": sentence})

    def end(self, totals: LiveTotals) -> None:
        """Write the totals."""
        self._write({"type": "ended", **totals.document()})

    def _write(self, document: dict[str, Any]) -> None:
        with writing("The lines"):
            self._file.write(json.dumps(document, allow_nan=False, ensure_ascii=False, separators=(",", ":")) + "\n")
            self._file.flush()


class KeptKeypoints(LiveListener):
    """Session of keypoints in a folder, which ``multicap reconstruct`` takes: files as they come.

    What was written is a session at any time, also when the disk is full or the command is killed.

    ``folder``: new or empty folder.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._num_frames: dict[str, int] = {}
        self._joints: JointSet | None = None

    def begin(self, cameras: Sequence[Camera], joints: JointSet, frame_rate_hz: float) -> None:
        """Write the calibration, and make the folders."""
        self._joints = joints
        with writing(self._folder.name):
            for camera in cameras:
                (self._folder / "keypoints" / camera.name).mkdir(parents=True, exist_ok=True)
            (self._folder / "calibration.json").write_bytes(encode(cameras))
            self._write_times([("camera", "frame", "time_s")])

    def take(self, camera: Camera, frame: DetectedFrame) -> None:
        """Write a frame and its time."""
        if self._joints is None:
            return
        number = self._num_frames.get(camera.name, 0)
        path = self._folder / "keypoints" / camera.name / f"frame_{number:012d}_keypoints.json"
        # Written beside the folders of cameras and moved: a killed command leaves no part of a frame among others.
        part, content = self._folder / ".part", encode_frame(frame.points_px, frame.score, self._joints)
        with writing(self._folder.name):
            # The time first: readers pass over a time without a frame, but not over a frame without a time.
            self._write_times([(camera.name, number, repr(frame.time_s))])
            try:
                part.write_bytes(content)
                part.replace(path)
            except OSError:
                part.unlink(missing_ok=True)
                raise
        self._num_frames[camera.name] = number + 1

    def _write_times(self, rows: Iterable[Sequence[object]]) -> None:
        table = io.StringIO(newline="")
        csv.writer(table, lineterminator="\n").writerows(rows)
        append_whole(self._folder / "timestamps.csv", table.getvalue().encode())


class Terminal(LiveListener):
    """Line on stderr that says how the capture goes, and what changes."""

    def __init__(self, status: Status) -> None:
        self._status, self._num_people = status, 0
        self._states: dict[str, str] = {}  # Told state of each output

    def begin(self, cameras: Sequence[Camera], joints: JointSet, frame_rate_hz: float) -> None:
        """Tell that it begins."""
        source = f"{len(cameras)} cameras" if cameras else "Test pattern"
        console.print(f"{source}, {frame_rate_hz:.4g} Hz. Ctrl-C ends the capture.")

    def tell(self, sentence: str) -> None:
        """Print what has changed."""
        console.print(sentence, soft_wrap=True)

    def show(self, instant: LiveInstant, latency_s: float) -> None:
        """Note how many people there are."""
        self._num_people = len(instant.people)

    def tick(self, totals: LiveTotals) -> None:
        """Show rate, people, latency and dropped frames; print states of outputs that have changed."""
        for output in totals.outputs:
            state = output.message or output.state
            if self._states.get(output.address) != state:
                self._states[output.address] = state
                self.tell(f"{output.address}: {state}")
        self._status.update(summary_line(totals, f"{self._num_people} people now"))


def summary_line(totals: LiveTotals, people: str) -> str:
    """Rate that was reached, people, latency and dropped frames, in one line."""
    p50, p95 = (totals.latencies.percentile_ms(percent) for percent in (50, 95))
    decoded = sum(camera.decoded for camera in totals.cameras)
    dropped = sum(camera.dropped for camera in totals.cameras)
    parts = [
        f"{totals.duration_s:.0f} s",
        f"{totals.instants / max(totals.duration_s, 1e-3):.1f} Hz",
        people,
        "no instant yet" if p50 is None else f"latency {p50:.0f} ms (p95 {p95:.0f} ms)",
        f"{100 * dropped / max(decoded, 1):.0f} % of frames dropped",
    ]
    return ", ".join(parts)


@contextmanager
def opened_output(path: Path) -> Iterator[IO[str]]:
    """Open a file for lines; raises ``PipelineError`` if it can't be written."""
    with writing(path.name):
        file = path.open("w", encoding="utf-8")
    try:
        yield file
    finally:
        # The line told about frames that could not be written.
        with suppress(OSError):
            file.close()
