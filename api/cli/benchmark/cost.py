"""`multicap benchmark all`: cost of a minute of four cameras, and its growth, as one JSON document."""

import os
import platform
import resource
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import psutil

from api.cli.benchmark.cost_tables import MINUTE_CAMERA_FRAMES, SCHEMA_VERSION, cost_tables
from api.cli.benchmark.profiles import looped_sample
from api.cli.benchmark.providers import sample_pictures
from api.cli.benchmark.tracking import crowd
from api.cli.console import JsonOption, console, emit, print_table, reporting, shows_help
from pipeline.core.options.config import PROFILES, Profile, ReconstructionConfig
from pipeline.core.options.providers import PACKAGES, ProviderName, choose_provider
from pipeline.core.progress import Progress
from pipeline.core.runtime.child_processes import ProcessPool
from pipeline.detection.providers.find import find_provider

if not shows_help():
    import numpy as np

    from api.cli.benchmark.long_takes import peak_rss_mib
    from pipeline.capture.keypoints import KeypointSession
    from pipeline.capture.session import Session, open_session
    from pipeline.core.runtime.packages import samples
    from pipeline.core.runtime.packages.samples import Sample
    from pipeline.detection import models
    from pipeline.detection.network import NETWORK_CLOCK
    from pipeline.detection.profiles.profile_detector import open_detection
    from pipeline.run.engine.local import reconstruct_to_files
    from pipeline.run.warm_up import warm_up
    from pipeline.validation.simulation.scenes import Simulation

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


def measure_all(sample: "Sample", folder: Path) -> dict[str, Any]:
    """Measure all costs; docs/lab/benchmarks.md has the keys. ``folder`` is for videos."""
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

    def __init__(self, sample: "Sample", folder: Path) -> None:
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


def describe_machine() -> dict[str, Any]:
    """Processor, cores, memory, versions, and the load of the last minute, which should be 0 before a measurement."""
    return {
        "processor": processor_name(),
        "cores": len(os.sched_getaffinity(0)),
        "memory_gib": psutil.virtual_memory().total / 2**30,
        "system": platform.system(),
        "python": platform.python_version(),
        "onnxruntime": version("onnxruntime"),
        "load": os.getloadavg()[0],
    }


def processor_name(cpuinfo: Path = Path("/proc/cpuinfo")) -> str:
    """Name of the processor as Linux states it, with its integer instructions that matter to networks."""
    facts: dict[str, str] = {}
    if cpuinfo.is_file():
        for line in cpuinfo.read_text().splitlines():
            key, _, value = line.partition(":")
            facts.setdefault(key.strip(), value.strip())
    flags = set(facts.get("flags", "").split())
    known = {"avx2": "AVX2", "avx512f": "AVX-512", "avx512_vnni": "VNNI", "amx_int8": "AMX"}
    name = facts.get("model name") or platform.processor() or platform.machine()
    return ", ".join([name, *(label for flag, label in known.items() if flag in flags)])


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


def simulated_session(simulation: "Simulation") -> "KeypointSession":
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


@dataclass(frozen=True, slots=True)
class JobCost:
    """Cost of a job.

    Seconds of a core are processor time of the job's process and of its children, in user and system mode. They do not
    count what other programs compute meanwhile.
    """

    cameras: int
    camera_frames: int  # Frames of all cameras
    people: int  # People who were found
    core_s: float  # Seconds of a core, all in all
    networks_core_s: float  # Seconds of a core in networks, of a job in one process
    decoding_core_s: float  # Seconds of a core in child processes, which open and decode videos
    wall_s: float  # Seconds that the job took
    stages_core_s: dict[str, float]  # Seconds of a core by stage; a child process counts where it ends
    peak_mib: float  # Largest resident memory of the job's process

    def as_dict(self) -> dict[str, Any]:
        """Figures for JSON, with the seconds of a core also as milliseconds a frame of a camera."""
        return asdict(self) | {"camera_frame_core_ms": 1e3 * self.core_s / self.camera_frames}


def measure_job(open_input: "Callable[[], Session]", config: ReconstructionConfig, provider: ProviderName) -> JobCost:
    """Measure a job, from opening its session to its result files, in a process of its own.

    ``open_input``: opens the session; a function that can be pickled. ``config``: what to do. ``provider``: provider of
    the networks.
    """
    with ProcessPool(1, choose_provider, (provider,)) as pool:
        cost: JobCost = pool.submit(_measure_here, open_input, config).result()
    return cost


def _measure_here(open_input: "Callable[[], Session]", config: ReconstructionConfig) -> JobCost:
    warm_up()
    stages = _StageClock()
    own_s, children_s = _core_s()
    networks_s, started_s = NETWORK_CLOCK.core_s, time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="multicap-") as folder:
        session = open_input()
        written = reconstruct_to_files(session, Path(folder) / "results", config, stages.update)
    stages.finish()
    own_end_s, children_end_s = _core_s()
    return JobCost(
        cameras=len(session.cameras),
        camera_frames=len(session.cameras) * session.timebase.num_frames,
        people=len(written.metrics["people"]),
        core_s=own_end_s + children_end_s - own_s - children_s,
        networks_core_s=NETWORK_CLOCK.core_s - networks_s,
        decoding_core_s=children_end_s - children_s,
        wall_s=time.perf_counter() - started_s,
        stages_core_s=stages.seconds,
        peak_mib=peak_rss_mib(),
    )


def _core_s() -> tuple[float, float]:
    """Processor time of this process, and of its children that have ended."""
    used = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    own_s, children_s = (usage.ru_utime + usage.ru_stime for usage in used)
    return own_s, children_s


class _StageClock:
    """Processor time by stage: the time between two reports of progress belongs to the stage of the first one."""

    def __init__(self) -> None:
        self._stage, self._since_s = "open", sum(_core_s())
        self.seconds: dict[str, float] = {}

    def update(self, progress: Progress) -> None:
        """Take in a step of a job."""
        self._count()
        self._stage = progress.stage

    def finish(self) -> None:
        """Count what the last stage has taken since its last report."""
        self._count()

    def _count(self) -> None:
        now_s = sum(_core_s())
        self.seconds[self._stage] = self.seconds.get(self._stage, 0.0) + now_s - self._since_s
        self._since_s = now_s
