"""Needs of a day's hours of cameras: processors, disk, network and rows, from measured costs of a job."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from api.cli.benchmark.plan.queue_simulation import StageLoad
from pipeline.capture.preflight_record import Preflight, PreflightCamera, PreflightTimebase
from pipeline.core.options.config import Profile, ReconstructionConfig
from pipeline.run.engine.plan import plan
from pipeline.run.engine.stage import SessionFacts
from pipeline.run.space import foreseen_space

DAY_S = 86_400.0
_DAYS_OF_MONTH = 30.0
_GIB = 2**30
# Rows of a chunk: its own and its output. Rows of a job beside them: its own, its session's, some ten
# events, some ten result files, and the audit.
_ROWS_OF_CHUNK, _ROWS_OF_JOB = 2, 24


@dataclass(frozen=True, slots=True)
class PlannedTake:
    """A take, as all of a day are alike."""

    cameras: int
    minutes: float
    rate_hz: float
    mbit_per_s: float  # Of a camera's video

    @property
    def camera_frames(self) -> int:
        """Frames of all cameras."""
        return round(self.cameras * self.minutes * 60.0 * self.rate_hz)

    @property
    def video_bytes(self) -> float:
        """Size of all videos."""
        return self.cameras * self.minutes * 60.0 * self.mbit_per_s * 1e6 / 8


@dataclass(frozen=True, slots=True)
class Needs:
    """Needs of a day. Processors are of the machine whose costs were measured."""

    jobs_a_day: float
    core_hours_a_camera_hour: float
    core_hours: float
    cores: int  # That are busy for the wanted share of the time
    upload_gib: float  # Of videos
    stored_gib: float  # Videos, outputs of stages and results, until sessions are deleted
    network_mbit_per_s: float  # To and from the store, on average
    chunks_a_job: int
    rows: float
    chunks_per_s: float

    def as_dict(self) -> dict[str, float]:
        """Needs by name."""
        return {name: getattr(self, name) for name in self.__slots__}


@dataclass(frozen=True, slots=True)
class Prices:
    """Prices of a supplier, in any currency."""

    core_hour: float
    gib_month: float
    days_kept: float  # Days until sessions are deleted

    def of_day(self, needs: Needs, camera_hours: float) -> dict[str, float]:
        """Price of a day: processors at all hours, and the storage of all sessions that are kept."""
        processors = needs.cores * 24.0 * self.core_hour
        storage = needs.stored_gib * self.days_kept * self.gib_month / _DAYS_OF_MONTH
        return {
            "processors_a_day": processors,
            "storage_a_day": storage,
            "camera_hour": (processors + storage) / camera_hours,
        }


def profile_of(cost: Mapping[str, Any], profile: Profile) -> Mapping[str, Any]:
    """Costs of a profile on the CPU in a document of `multicap benchmark all`; ``ValueError`` without them."""
    for measured in cost.get("profiles", ()):
        if measured["profile"] == profile and measured["provider"] == "cpu":
            return dict(measured)
    raise ValueError(f"The document has no costs of the profile {profile} on the CPU.")


def needs_of(
    cost: Mapping[str, Any],
    profile: Profile,
    take: PlannedTake,
    camera_hours: float,
    utilization: float,
    num_machines: int,
) -> Needs:
    """Needs of so many hours of cameras a day, in takes that are alike.

    Parameters
    ----------
    cost
        Document of `multicap benchmark all`.
    utilization
        Share of the time for which workers shall be busy.
    num_machines
        Machines of workers: each video is fetched by one of them if there are at most as many as cameras, else by as
        many as there are machines to a camera.
    """
    job_core_s = sum(load.num_chunks * load.chunk_s for load in stage_loads(cost, profile, take))
    jobs_a_day = camera_hours / (take.cameras * take.minutes / 60.0)
    core_hours = jobs_a_day * job_core_s / 3600.0
    space = foreseen_space(_preflight(take), ReconstructionConfig(profile=profile))
    fetches = max(1.0, num_machines / take.cameras)
    # Shared uploads go to the bucket as blocks, come back, and go there as files; workers fetch them.
    moved_bytes = jobs_a_day * (take.video_bytes * (3.0 + fetches) + 2.0 * space.store_bytes)
    num_chunks = sum(_chunks(take, profile).values())
    return Needs(
        jobs_a_day=jobs_a_day,
        core_hours_a_camera_hour=core_hours / camera_hours,
        core_hours=core_hours,
        cores=math.ceil(core_hours / 24.0 / utilization),
        upload_gib=jobs_a_day * take.video_bytes / _GIB,
        stored_gib=jobs_a_day * (take.video_bytes + space.store_bytes) / _GIB,
        network_mbit_per_s=moved_bytes * 8.0 / 1e6 / DAY_S,
        chunks_a_job=num_chunks,
        rows=jobs_a_day * (num_chunks * _ROWS_OF_CHUNK + _ROWS_OF_JOB),
        chunks_per_s=jobs_a_day * num_chunks / DAY_S,
    )


def stage_loads(
    cost: Mapping[str, Any], profile: Profile, take: PlannedTake, most_chunks: int | None = None
) -> tuple[StageLoad, ...]:
    """Stages of a job of a take with their chunks, from the costs of a job.

    What the measured job took for each of its camera frames, each frame of the take takes. ``most_chunks`` joins
    chunks of a stage, for simulations of many jobs.
    """
    measured = profile_of(cost, profile)
    per_frame_s = {stage: seconds / measured["camera_frames"] for stage, seconds in measured["stages_core_s"].items()}
    # Frames further on cost less than those of a short job, most of all in detection.
    scale = measured["added_camera_frame_core_ms"] / measured["camera_frame_core_ms"]
    loads = []
    for stage, number in _chunks(take, profile).items():
        num_chunks = number if most_chunks is None else min(number, most_chunks)
        stage_s = scale * per_frame_s.get(stage, 0.0) * take.camera_frames
        loads.append(StageLoad(num_chunks, stage_s / num_chunks))
    return tuple(loads)


def _chunks(take: PlannedTake, profile: Profile) -> dict[str, int]:
    """Numbers of chunks of a job, by stage."""
    preflight = _preflight(take)
    facts = SessionFacts(
        inputs=("plan",),
        num_frames=preflight.timebase.num_frames,
        frame_rate_hz=take.rate_hz,
        stretches=preflight.stretches,
        camera_rates_hz={camera.name: take.rate_hz for camera in preflight.cameras},
        has_videos=True,
    )
    config = ReconstructionConfig(profile=profile)
    codes = _NoCodes()
    return {stage.name: sum(1 for _ in stage.tasks) for stage in plan(facts, config, codes)}


class _NoCodes(dict[str, str]):
    """Codes of stages of which no output is asked for."""

    def __missing__(self, stage: str) -> str:
        return ""


def _preflight(take: PlannedTake) -> Preflight:
    num_frames = max(1, round(take.minutes * 60.0 * take.rate_hz))
    cameras: Sequence[str] = [f"cam_{number}" for number in range(take.cameras)]
    return Preflight(
        cameras=tuple(PreflightCamera(name, f"{name}.mp4", (1920, 1080), take.rate_hz, num_frames) for name in cameras),
        timebase=PreflightTimebase(0.0, take.rate_hz, num_frames),
        stretches=(range(num_frames),),
    )
