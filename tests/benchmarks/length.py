"""Benchmark `length`: cost of a frame and memory of each stage by the length of a take of keypoints."""

import resource
import tempfile
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from api.cli.console import JsonOption, emit, print_table, reporting
from pipeline.capture.keypoints import KeypointSession
from pipeline.core.data.cameras import FrameTimes, Timebase
from pipeline.core.data.detections import Detections
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.progress import Progress
from pipeline.core.runtime.child_processes import ProcessPool
from pipeline.run.engine.local import reconstruct_to_files
from pipeline.run.warm_up import warm_up
from pipeline.validation.simulation.motion.director import Cast
from pipeline.validation.simulation.rigs import Clock, Layout, Rig
from pipeline.validation.simulation.scenes import Scene, Simulation, record

_RATE_HZ = 30.0
_CLIP_S = 20.0
_AREA_M = (8.0, 6.0)
_STATUS, _CLEAR = Path("/proc/self/status"), Path("/proc/self/clear_refs")
_RESET_PEAK = "5"  # of Linux's clear_refs: the peak becomes the memory of now


def _user_s() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_utime


@dataclass(slots=True)
class StageCosts:
    """Processor time and peak memory of each stage of a reconstruction, by its progress."""

    cpu_s: defaultdict[str, float] = field(default_factory=lambda: defaultdict(float))
    peak_mib: defaultdict[str, float] = field(default_factory=lambda: defaultdict(float))
    stage: str = "start"
    _last_s: float = field(default_factory=_user_s)

    def update(self, progress: Progress) -> None:
        """Count what was used since the last call for the stage that worked until now."""
        if progress.stage != self.stage:
            self.finish()
            self.stage = progress.stage

    def finish(self) -> None:
        """Count what the last stage used."""
        now_s = _user_s()
        self.cpu_s[self.stage] += now_s - self._last_s
        self.peak_mib[self.stage] = max(self.peak_mib[self.stage], _peak_rss_mib())
        self._last_s = now_s
        _CLEAR.write_text(_RESET_PEAK)


def long_session(simulation: Simulation, num_frames: int) -> KeypointSession:
    """Session of keypoints in which a simulated take goes forwards and backwards, up to a number of frames."""
    times, detections = {}, {}
    for camera in simulation.cameras:
        seen, clip = simulation.detections[camera.name], len(simulation.times[camera.name].time_s)
        times[camera.name] = FrameTimes(np.arange(num_frames) / simulation.timebase.frame_rate_hz)
        detections[camera.name] = _to_and_fro(seen, clip, num_frames)
    return KeypointSession(
        cameras=simulation.cameras,
        times=times,
        timebase=Timebase(0.0, simulation.timebase.frame_rate_hz, num_frames),
        detections=detections,
        joints=simulation.joints,
        folders={camera.name: camera.name for camera in simulation.cameras},
        findings=(),
    )


def _to_and_fro(seen: Detections, clip: int, num_frames: int) -> Detections:
    """Detections of a clip of so many frames, forwards and backwards."""
    forwards, backwards = np.arange(len(seen.frame)), np.argsort(-seen.frame, kind="stable")
    rows, frames = [], []
    for number, start in enumerate(range(0, num_frames, clip)):
        chosen = backwards if number % 2 else forwards
        within = clip - 1 - seen.frame[chosen] if number % 2 else seen.frame[chosen]
        is_wanted = start + within < num_frames
        rows.append(chosen[is_wanted])
        frames.append(start + within[is_wanted])
    row = np.concatenate(rows)
    return replace(
        seen,
        frame=np.concatenate(frames),
        keypoints_px=seen.keypoints_px[row],
        score=seen.score[row],
        box_px=seen.box_px[row],
    )


def simulated(num_people: int, num_cameras: int) -> Simulation:
    """Clip of people who walk about in a ring of cameras."""
    rig = Rig(Layout.RING, num_cameras, (6.0, 5.0), 2.6)
    scene = Scene(rig, Cast(num_people, _AREA_M, walking=0.7), Clock(_RATE_HZ), duration_s=_CLIP_S)
    return record(scene, 0)


def measure(minutes: float, num_people: int, num_cameras: int, config: ReconstructionConfig) -> dict[str, Any]:
    """Costs of each stage of the reconstruction of a take; to be called in a process of its own."""
    warm_up()
    session = long_session(simulated(num_people, num_cameras), round(60 * minutes * _RATE_HZ))
    given_mib = sum(_num_bytes(seen) for seen in session.detections.values()) / 2**20
    with tempfile.TemporaryDirectory(prefix="multicap-") as folder:
        costs = StageCosts()
        written = reconstruct_to_files(session, Path(folder) / "results", config, costs.update)
        costs.finish()
        num_bytes = sum(path.stat().st_size for path in written.paths)
    return {
        "minutes": minutes,
        "frames": session.timebase.num_frames,
        "people": len(written.metrics["people"]),
        "keypoints_mib": given_mib,
        "result_bytes": num_bytes,
        "cpu_s": dict(costs.cpu_s),
        "peak_mib": dict(costs.peak_mib),
    }


def growth(takes: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Processor time of a frame in the longest take as a multiple of that in the shortest, by stage."""
    first, last = takes[0], takes[-1]
    return {
        stage: (last["cpu_s"][stage] / last["frames"]) / (seconds / first["frames"])
        for stage, seconds in first["cpu_s"].items()
        if seconds > 0 and stage in last["cpu_s"]
    }


def _num_bytes(seen: Detections) -> int:
    return seen.frame.nbytes + seen.keypoints_px.nbytes + seen.score.nbytes + seen.box_px.nbytes


def _peak_rss_mib() -> float:
    """Largest resident memory since it was reset."""
    (line,) = (line for line in _STATUS.read_text().splitlines() if line.startswith("VmHWM"))
    return int(line.split()[1]) / 1024


def length(
    minutes: Annotated[
        tuple[float, float], typer.Option(min=0.1, help="Lengths of the shorter and the longer take.")
    ] = (1.0, 4.0),
    people: Annotated[int, typer.Option(min=1, max=32, help="Number of people.")] = 10,
    cameras: Annotated[int, typer.Option(min=2, max=64, help="Number of cameras.")] = 4,
    as_json: JsonOption = False,
) -> None:
    """Compare what a frame costs in a short and in a long take of keypoints: processor time and memory by stage."""
    with reporting(as_json):
        config = ReconstructionConfig()
        takes: list[dict[str, Any]] = []
        for number in minutes:
            # A process for each take: the peak of one take would hide the peak of the next.
            with ProcessPool(1) as pool:
                takes += pool.map(measure, [number], [people], [cameras], [config])
        ratios = growth(takes)
    if as_json:
        emit({"takes": takes, "ratio_of_cost_per_frame": ratios})
        return
    print_table(
        ("stage", *(f"{take['minutes']:g} min, s" for take in takes), "ratio per frame", "peak, MiB"),
        (
            (
                stage,
                *(f"{take['cpu_s'].get(stage, 0.0):.1f}" for take in takes),
                f"{ratio:.2f}",
                ", ".join(f"{take['peak_mib'].get(stage, 0.0):.0f}" for take in takes),
            )
            for stage, ratio in ratios.items()
        ),
    )
