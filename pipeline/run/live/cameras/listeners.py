"""Listeners of live captures from cameras that the command line and the service share, and the run of both."""

from collections import Counter, deque
from collections.abc import Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from pipeline.core.data.cameras import Camera
from pipeline.core.errors import ChildError, InputError, Problem
from pipeline.core.joints import JointSet
from pipeline.core.options.config import MotionChoices
from pipeline.core.options.rules import collecting, require
from pipeline.core.problems.finding_codes import PARAMETER_RANGE
from pipeline.core.runtime.child_processes import ProcessPool
from pipeline.motion.skeleton.model import SKELETON
from pipeline.run.live.cameras.detector_pool import DetectorPool, start_detecting
from pipeline.run.live.cameras.run import CameraRun, LiveListener
from pipeline.run.live.cameras.totals import CameraTotals, LiveTotals
from pipeline.run.live.packing import described_camera
from pipeline.run.live.records import LiveInstant
from pipeline.run.live.vmc import VmcSender
from pipeline.run.warm_up import warm_up

# A receiver whose person is out of sight for so long gets the next person.
_GONE_S = 2.0
_MAX_DIGITS = 5  # of a port
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
        }

    def _camera(self, camera: CameraTotals) -> dict[str, Any]:
        before = self._before.get(camera.name, CameraTotals(camera.name))
        self._before[camera.name] = replace(camera)
        decoded, detected = camera.decoded - before.decoded, camera.detected - before.detected
        return {"name": camera.name, "state": camera.state, "decoded_hz": decoded, "detected_hz": detected} | {
            "dropped": camera.dropped,
            "lost": camera.lost,
        }


class VmcReceivers(LiveListener):
    """Receivers of VMC, each of which shows one person.

    The first person goes to the first receiver, and so on. A receiver whose person has gone gets the next one.
    """

    def __init__(self, senders: Sequence[VmcSender]) -> None:
        self._senders = senders
        self._shown: list[int | None] = [None] * len(senders)
        self._seen_s = [0.0] * len(senders)

    def show(self, instant: LiveInstant, latency_s: float) -> None:
        """Send the people."""
        people = {person.id: person for person in instant.people}
        for place, number in enumerate(self._shown):
            if number in people:
                self._seen_s[place] = instant.time_s
            elif instant.time_s - self._seen_s[place] > _GONE_S:
                self._shown[place] = None
        waiting = iter(sorted(people.keys() - set(self._shown)))
        for place, sender in enumerate(self._senders):
            if self._shown[place] is None and (number := next(waiting, None)) is not None:
                self._shown[place], self._seen_s[place] = number, instant.time_s
            person = people.get(self._shown[place] or 0)
            if person is not None:
                sender.send(replace(instant, people=(replace(person, id=1),)))


@contextmanager
def vmc_receivers(addresses: Sequence[str], allow_network: bool) -> Iterator[VmcReceivers]:
    """Open senders to receivers, each ``[HOST:]PORT``, during the block; raises ``InputError`` with all problems."""
    with ExitStack() as opened:
        with collecting() as collect:
            found = [collect(partial(_vmc_sender, address, allow_network)) for address in addresses]
            collect(lambda: require(_repeated_receivers(addresses)))
        yield VmcReceivers([opened.enter_context(sender) for sender in found if sender is not None])


def _vmc_sender(address: str, allow_network: bool) -> VmcSender:
    host, port = _host_and_port(address)
    if not (port.isdecimal() and len(port) <= _MAX_DIGITS):
        message, hint = f"{address!r} is not [HOST:]PORT.", "Write it as 39539 or 127.0.0.1:39539."
        raise InputError([Problem(PARAMETER_RANGE, message, field="vmc", hint=hint)])
    return VmcSender(host, [int(port)], allow_network=allow_network)


def _host_and_port(address: str) -> tuple[str, str]:
    host, _, port = address.rpartition(":")
    return host.strip("[]") or "127.0.0.1", port


def _repeated_receivers(addresses: Sequence[str]) -> Iterator[Problem]:
    receivers = Counter(map(_host_and_port, addresses))
    for (host, port), count in receivers.items():
        if count > 1:
            message, hint = f"The receiver {host}:{port} is stated twice.", "A receiver shows one person."
            yield Problem(PARAMETER_RANGE, message, field="vmc", hint=hint)
