"""Growth of the cost with cameras, people and length: pictures of the sample, and simulated keypoints."""

import time
from collections import defaultdict
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from api.cli.benchmark.cost.job import measure_job
from api.cli.benchmark.providers import sample_pictures
from api.cli.benchmark.tracking import crowd
from pipeline.capture.keypoints import KeypointSession
from pipeline.core.options.config import ReconstructionConfig
from pipeline.detection.profiles.detection import open_detection
from pipeline.validation.simulation.scenes import Simulation

_BASE: Mapping[str, float] = {"cameras": 4, "people": 3, "duration_s": 10.0}
_SIZES: Mapping[str, tuple[float, ...]] = {
    "cameras": (2, 4, 8),
    "people": (1, 3, 6),
    "duration_s": (10.0, 30.0),
}


def measure_pictures(config: ReconstructionConfig, videos: Sequence[Path]) -> list[dict[str, Any]]:
    """Milliseconds of a core for a picture by the number of bodies found in it, on the provider of this process.

    Returns a record for each number of bodies: ``profile``, ``bodies``, the number of ``pictures``, and ``core_ms``,
    the median of their times.
    """
    detector = open_detection(config.networks, config.detected_joints)
    times_ms: defaultdict[int, list[float]] = defaultdict(list)
    for video in videos:
        pictures = sample_pictures(video)
        detector.detect(pictures[0])
        for picture in pictures:
            started_s = time.thread_time()
            bodies = detector.detect(picture)
            times_ms[len(bodies.score)].append(1e3 * (time.thread_time() - started_s))
    return [
        {"profile": config.profile, "bodies": bodies, "pictures": len(times), "core_ms": float(np.median(times))}
        for bodies, times in sorted(times_ms.items())
    ]


def measure_keypoints() -> dict[str, list[dict[str, Any]]]:
    """Cost of jobs on simulated keypoints by cameras, people and length, each varied alone."""
    base = _measure(_BASE)
    return {
        varied: [base if value == _BASE[varied] else _measure({**_BASE, varied: value}) for value in values]
        for varied, values in _SIZES.items()
    }


def _measure(size: Mapping[str, float]) -> dict[str, Any]:
    simulation = crowd(int(size["cameras"]), int(size["people"]), size["duration_s"])
    cost = measure_job(partial(simulated_session, simulation), ReconstructionConfig(), "cpu")
    return {**cost.as_dict(), "simulated_people": int(size["people"]), "duration_s": size["duration_s"]}


def simulated_session(simulation: Simulation) -> KeypointSession:
    """Session of the detections of a simulation, as if they were read from keypoint files."""
    return KeypointSession(
        cameras=simulation.cameras,
        times=simulation.times,
        timebase=simulation.timebase,
        detections=simulation.detections,
        joints=simulation.joints,
        folders={},
        findings=(),
    )
