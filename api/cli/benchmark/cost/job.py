"""Cost of one job: processor time by part and by stage, and memory; each job runs in a process of its own."""

import resource
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from api.cli.benchmark.takes import peak_rss_mib
from pipeline.capture.session import Session
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.options.providers import ProviderName, choose_provider
from pipeline.core.progress import Progress
from pipeline.core.runtime.child_processes import ProcessPool
from pipeline.detection.session import NETWORK_CLOCK
from pipeline.run.engine.local import reconstruct_to_files
from pipeline.run.warm_up import warm_up


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


def measure_job(open_input: Callable[[], Session], config: ReconstructionConfig, provider: ProviderName) -> JobCost:
    """Measure a job, from opening its session to its result files, in a process of its own.

    Parameters
    ----------
    open_input
        Opens the session; a function that can be pickled.
    config
        What to do.
    provider
        Provider of the networks.
    """
    with ProcessPool(1, choose_provider, (provider,)) as pool:
        cost: JobCost = pool.submit(_measure_here, open_input, config).result()
    return cost


def _measure_here(open_input: Callable[[], Session], config: ReconstructionConfig) -> JobCost:
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
    """Processor time by stage: that between two reports of progress belongs to the stage of the former."""

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
