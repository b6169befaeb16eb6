"""`multicap benchmark all`: cost of a minute of four cameras, and its growth, as one JSON document."""

from collections.abc import Sequence
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

from api.cli.benchmark.cost.growth import measure_keypoints, measure_pictures
from api.cli.benchmark.cost.job import measure_job
from api.cli.benchmark.cost.machine import describe_machine
from api.cli.benchmark.cost.tables import MINUTE_CAMERA_FRAMES, SCHEMA_VERSION, cost_tables
from api.cli.console import JsonOption, console, emit, print_table, reporting
from pipeline.capture.session import Session, open_session
from pipeline.config import PROFILES, Profile, ReconstructionConfig
from pipeline.detect import models
from pipeline.detect.providers.find import find_provider
from pipeline.providers import PACKAGES, ProviderName, choose_provider
from pipeline.runtime.child_processes import ProcessPool
from pipeline.runtime.packages import samples
from pipeline.runtime.packages.samples import Sample
from pipeline.stages.stage import LOOK
from pipeline.warm_up import warm_up

# Output frames of the sample in most jobs, and in those of several lengths.
_NUM_FRAMES = 50
_LENGTHS = (50, 100)
_QUICKEST: Profile = "fast"
_MIDDLE: Profile = "balanced"
_NUM_CAMERAS = (2, 4)
_PROCESSES = (1, 2)
# Stages of which a take of any length has as much: they open videos, and look at a few frames of each.
_ONCE_A_JOB = ("open", LOOK)


def all_costs(as_json: JsonOption = False) -> None:
    """Measure what a minute of four cameras costs, and how the cost grows, in some minutes."""
    with reporting(as_json):
        for profile in PROFILES:
            models.install_networks(ReconstructionConfig(profile=profile))
        warm_up()
        cost = measure_all(samples.install())
    if as_json:
        emit(cost)
        return
    for table in cost_tables(cost):
        print_table(table.columns, table.rows, table.title)


def measure_all(sample: Sample) -> dict[str, Any]:
    """Measure all costs; docs/benchmarks.md has the keys."""
    machine = describe_machine()
    footage = _Footage(sample)
    return {
        "schema_version": SCHEMA_VERSION,
        "measured_at": datetime.now(UTC).isoformat(timespec="seconds"),
        "machine": machine,
        "profiles": [
            *(_with_minutes(footage.job(profile)) for profile in PROFILES),
            *(_with_minutes(footage.job(_MIDDLE, provider=provider)) for provider in _other_providers()),
        ],
        "processes": [footage.job(_MIDDLE, processes=processes) for processes in _PROCESSES],
        "length": [footage.job(_QUICKEST, num_frames=num_frames) for num_frames in _LENGTHS],
        "cameras": [footage.job(_QUICKEST, num_cameras=num_cameras) for num_cameras in _NUM_CAMERAS],
        "pictures": [row for profile in PROFILES for row in _pictures(profile, list(sample.videos.values()))],
        "keypoints": measure_keypoints(),
    }


def _other_providers() -> list[ProviderName]:
    """Providers that work here beside the CPU's."""
    return [name for name in PACKAGES if find_provider(name).name == name]


class _Footage:
    """Beginning of the sample's videos, and the jobs that were measured on it."""

    def __init__(self, sample: Sample) -> None:
        self._sample = sample
        self._jobs: dict[tuple[object, ...], dict[str, Any]] = {}

    def job(
        self,
        profile: Profile,
        *,
        provider: ProviderName = "cpu",
        processes: int = 1,
        num_frames: int = _NUM_FRAMES,
        num_cameras: int = _NUM_CAMERAS[-1],
    ) -> dict[str, Any]:
        """Measure a job on the first frames of the first cameras, once."""
        key = profile, provider, processes, num_frames, num_cameras
        if key not in self._jobs:
            self._jobs[key] = self._measure(*key)
        return self._jobs[key]

    def _measure(
        self, profile: Profile, provider: ProviderName, processes: int, num_frames: int, num_cameras: int
    ) -> dict[str, Any]:
        videos = list(self._sample.videos.values())[:num_cameras]
        config = ReconstructionConfig(profile=profile, processes=processes)
        cost = measure_job(partial(_open_part, videos, self._sample.calibration, num_frames), config, provider)
        console.print(f"{profile} {provider}, {cost.camera_frames} camera frames: {cost.core_s:.1f} s of a core")
        return {"profile": profile, "provider": provider, "processes": processes, **cost.as_dict()}


def _open_part(videos: Sequence[Path], calibration: Path, num_frames: int) -> Session:
    return open_session(videos, calibration).restricted(range(num_frames))


def _with_minutes(job: dict[str, Any]) -> dict[str, Any]:
    """Add the cost of a minute of four cameras by frame rate: each frame costs as much as those of the job."""
    once_s = sum(job["stages_core_s"].get(stage, 0.0) for stage in _ONCE_A_JOB)
    frame_s = (job["core_s"] - once_s) / job["camera_frames"]
    minutes_s = {rate: once_s + frame_s * num_frames for rate, num_frames in MINUTE_CAMERA_FRAMES.items()}
    return job | {"minute_core_s": minutes_s}


def _pictures(profile: Profile, videos: Sequence[Path]) -> list[dict[str, Any]]:
    with ProcessPool(1, choose_provider, ("cpu",)) as pool:
        rows: list[dict[str, Any]] = pool.submit(
            measure_pictures, ReconstructionConfig(profile=profile), videos
        ).result()
    return rows
