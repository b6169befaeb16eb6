"""`multicap benchmark all`: cost of a minute of four cameras, and its growth, as one JSON document."""

import tempfile
from collections.abc import Sequence
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

from api.cli.benchmark.cost.growth import measure_keypoints, measure_pictures
from api.cli.benchmark.cost.job import measure_job
from api.cli.benchmark.cost.machine import describe_machine
from api.cli.benchmark.cost.tables import MINUTE_CAMERA_FRAMES, SCHEMA_VERSION, cost_tables
from api.cli.benchmark.profiles import looped_sample
from api.cli.console import JsonOption, console, emit, print_table, reporting
from pipeline.capture.session import open_session
from pipeline.core.options.config import PROFILES, Profile, ReconstructionConfig
from pipeline.core.options.providers import PACKAGES, ProviderName, choose_provider
from pipeline.core.runtime.child_processes import ProcessPool
from pipeline.core.runtime.packages import samples
from pipeline.core.runtime.packages.samples import Sample
from pipeline.detection import models
from pipeline.detection.providers.find import find_provider
from pipeline.run.warm_up import warm_up

# Repetitions of the sample in its videos.
_LOOPS = (1, 2)
_QUICKEST: Profile = "fast"
_MIDDLE: Profile = "balanced"
_NUM_CAMERAS = (2, 4)
_PROCESSES = (1, 2)


def all_costs(as_json: JsonOption = False) -> None:
    """Measure what a minute of four cameras costs, and how the cost grows, in some minutes."""
    with reporting(as_json), tempfile.TemporaryDirectory(prefix="multicap-") as folder:
        for profile in PROFILES:
            models.install_networks(ReconstructionConfig(profile=profile))
        warm_up()
        cost = measure_all(samples.install(), Path(folder))
    if as_json:
        emit(cost)
        return
    for table in cost_tables(cost):
        print_table(table.columns, table.rows, table.title)


def measure_all(sample: Sample, folder: Path) -> dict[str, Any]:
    """Measure all costs; docs/benchmarks.md has the keys. ``folder`` is for videos."""
    machine = describe_machine()
    footage = _Footage(sample, folder)
    return {
        "schema_version": SCHEMA_VERSION,
        "measured_at": datetime.now(UTC).isoformat(timespec="seconds"),
        "machine": machine,
        "profiles": [
            *(footage.minutes(profile, "cpu") for profile in PROFILES),
            *(footage.minutes(_MIDDLE, provider) for provider in _other_providers()),
        ],
        "processes": [footage.job(_MIDDLE, processes=processes) for processes in _PROCESSES],
        "length": [footage.job(_QUICKEST, loops=loops) for loops in _LOOPS],
        "cameras": [footage.job(_QUICKEST, num_cameras=num_cameras) for num_cameras in _NUM_CAMERAS],
        "pictures": [row for profile in PROFILES for row in _pictures(profile, list(sample.videos.values()))],
        "keypoints": measure_keypoints(),
    }


def _other_providers() -> list[ProviderName]:
    """Providers that work here beside the CPU's."""
    return [name for name in PACKAGES if find_provider(name).name == name]


class _Footage:
    """Videos of the sample, repeated, and the jobs that were measured on them."""

    def __init__(self, sample: Sample, folder: Path) -> None:
        self._sample, self._folder = sample, folder
        self._jobs: dict[tuple[object, ...], dict[str, Any]] = {}

    def job(
        self,
        profile: Profile,
        *,
        provider: ProviderName = "cpu",
        processes: int = 1,
        loops: int = _LOOPS[0],
        num_cameras: int = _NUM_CAMERAS[-1],
    ) -> dict[str, Any]:
        """Measure a job on repeated videos of the first cameras, once."""
        key = profile, provider, processes, loops, num_cameras
        if key not in self._jobs:
            self._jobs[key] = self._measure(*key)
        return self._jobs[key]

    def minutes(self, profile: Profile, provider: ProviderName) -> dict[str, Any]:
        """Longer one of two jobs, with the cost of a minute of four cameras by frame rate.

        Frames that are added cost what they cost from the shorter job to the longer one. The shorter job itself has
        much that each job does once, such as opening networks and looking at a few frames of each video.
        """
        short, long = (self.job(profile, provider=provider, loops=loops) for loops in _LOOPS)
        added_s = (long["core_s"] - short["core_s"]) / (long["camera_frames"] - short["camera_frames"])
        minutes_s = {
            rate: long["core_s"] + added_s * (num_frames - long["camera_frames"])
            for rate, num_frames in MINUTE_CAMERA_FRAMES.items()
        }
        return long | {"added_camera_frame_core_ms": 1e3 * added_s, "minute_core_s": minutes_s}

    def _measure(
        self, profile: Profile, provider: ProviderName, processes: int, loops: int, num_cameras: int
    ) -> dict[str, Any]:
        folder = self._folder / str(loops)
        if not folder.exists():
            folder.mkdir()
            looped_sample(self._sample, loops, folder)
        videos = [
            path if loops == 1 else folder / path.name for path in list(self._sample.videos.values())[:num_cameras]
        ]
        config = ReconstructionConfig(profile=profile, processes=processes)
        cost = measure_job(partial(open_session, videos, self._sample.calibration), config, provider)
        console.print(f"{profile} {provider}, {cost.camera_frames} camera frames: {cost.core_s:.1f} s of a core")
        return {"profile": profile, "provider": provider, "processes": processes, **cost.as_dict()}


def _pictures(profile: Profile, videos: Sequence[Path]) -> list[dict[str, Any]]:
    with ProcessPool(1, choose_provider, ("cpu",)) as pool:
        rows: list[dict[str, Any]] = pool.submit(
            measure_pictures, ReconstructionConfig(profile=profile), videos
        ).result()
    return rows
