"""Listeners of live captures from cameras that the command line and the service share, and the run of both."""

import threading
from collections import deque
from collections.abc import Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from pipeline.core.data.cameras import Camera
from pipeline.core.errors import ChildError
from pipeline.core.joints import JointSet
from pipeline.core.options.config import MotionChoices
from pipeline.core.runtime.child_processes import ProcessPool
from pipeline.motion.skeleton.model import SKELETON
from pipeline.run.live.cameras.detector_pool import DetectorPool, start_detecting
from pipeline.run.live.cameras.run import CameraRun, LiveListener
from pipeline.run.live.cameras.totals import CameraTotals, LiveTotals
from pipeline.run.live.outputs import pattern
from pipeline.run.live.outputs.runner import LiveOutputs
from pipeline.run.live.packing import described_camera
from pipeline.run.live.records import LiveInstant
from pipeline.run.warm_up import warm_up

# Instants whose latencies are shown.
_NUM_SHOWN = 200


def capture(run: CameraRun, choices: MotionChoices) -> None:
    """Compile kernels, start the processes that detect, and run a capture to its end.

    Raises ``InputError`` with the problems of all cameras that can't be used. Raises ``ChildError`` if the processes
    that detect are ended again and again.
    """
    warm_up([run.joints])
    try:
        make_pool = partial(ProcessPool, run.num_processes, start_detecting, [choices])
        with DetectorPool(make_pool, run.tell) as pool:
            run.run(pool)
    except BrokenProcessPool as error:
        raise ChildError(
            "Processes that detect were ended from outside again and again, most likely for lack of memory."
        ) from error


def ready_document(cameras: Sequence[Camera], joints: JointSet, frame_rate_hz: float) -> dict[str, Any]:
    """Names of cameras and joints of instants, like the message ``ready`` of the service."""
    return {
        "type": "ready",
        "cameras": [camera.name for camera in cameras],
        "joints": joints.names,
        "bones": [joint.name for joint in SKELETON],
        "parents": [joint.parent for joint in SKELETON],
        "rig": [described_camera(camera) for camera in cameras],
        "frame_rate_hz": frame_rate_hz,
    }


class StatusFigures:
    """Figures of the last second of a capture, as pages show them."""

    def __init__(self) -> None:
        self._latencies_s: deque[float] = deque(maxlen=_NUM_SHOWN)
        self._before: dict[str, CameraTotals] = {}
        self._instants_before = 0

    def add(self, latency_s: float) -> None:
        """Take the latency of an instant."""
        self._latencies_s.append(latency_s)

    def message(self, totals: LiveTotals) -> dict[str, Any]:
        """Message ``status``; its rates count from the message before."""
        cameras = [self._camera(camera) for camera in totals.cameras]
        instants, self._instants_before = totals.instants - self._instants_before, totals.instants
        p50, p95 = np.percentile(self._latencies_s, [50, 95]).tolist() if self._latencies_s else (None, None)
        return {
            "type": "status",
            "time_s": totals.duration_s,
            "instants_hz": instants,
            "latency_s": {"p50": p50, "p95": p95},
            "cameras": cameras,
            "outputs": [output.document() for output in totals.outputs],
        }

    def _camera(self, camera: CameraTotals) -> dict[str, Any]:
        before = self._before.get(camera.name, CameraTotals(camera.name))
        self._before[camera.name] = replace(camera)
        decoded, detected = camera.decoded - before.decoded, camera.detected - before.detected
        return {"name": camera.name, "state": camera.state, "decoded_hz": decoded, "detected_hz": detected} | {
            "dropped": camera.dropped,
            "lost": camera.lost,
        }


class PatternRun:
    """Live capture of the test pattern: a simulated person in place of cameras."""

    def __init__(self, listener: LiveListener) -> None:
        self._listener, self._stopped = listener, threading.Event()
        self.totals = LiveTotals([], frame_rate_hz=pattern.RATE_HZ)

    def stop(self) -> None:
        """End the capture soon."""
        self._stopped.set()

    def run(self) -> None:
        """Run until ``stop``."""
        self._listener.begin([], pattern.LAYOUT.joints, pattern.RATE_HZ)
        self.totals.people = 1
        pattern.play_pattern(self._show, self._tick, self._stopped)

    def _show(self, instant: LiveInstant) -> None:
        self.totals.instants += 1
        self.totals.latencies.add(0.0)
        self._listener.show(instant, 0.0)

    def _tick(self, time_s: float) -> None:
        self.totals.duration_s = time_s
        self._listener.tick(self.totals)


class OutputListener(LiveListener):
    """Outputs to other programs as a listener."""

    def __init__(self, outputs: LiveOutputs, totals: LiveTotals) -> None:
        self._outputs = outputs
        totals.outputs = outputs.statuses

    def begin(self, cameras: Sequence[Camera], joints: JointSet, frame_rate_hz: float) -> None:
        """Open the outputs."""
        self._outputs.begin(joints.names, frame_rate_hz)

    def show(self, instant: LiveInstant, latency_s: float) -> None:
        """Send the people."""
        self._outputs.show(instant)
