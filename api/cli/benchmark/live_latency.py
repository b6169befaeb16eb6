"""`multicap benchmark live`: time from a frame's arrival to people and their skeletons, and their error."""

import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Annotated, Any

import psutil
import typer

from api.cli.benchmark.live_outputs import measure_outputs
from api.cli.benchmark.tracking import crowd
from api.cli.console import JsonOption, emit, print_table, reporting, shows_help
from pipeline.core.options.config import ReconstructionConfig

if not shows_help():
    import numpy as np

    from pipeline.association.tracking.track_people import reconstruct_tracks
    from pipeline.association.tracking.tracking_parameters import derive_parameters
    from pipeline.core.data.people import Track3D
    from pipeline.motion.skeleton.animate import animate
    from pipeline.run.live.capture import LiveCapture
    from pipeline.run.live.records import LiveInstant, RecordedFrame, recorded_frames
    from pipeline.run.live.settings import LiveSettings
    from pipeline.run.warm_up import warm_up
    from pipeline.validation.simulation.scenes import SCENES, Simulation, record

# Cameras, people and rate.
_SIZES = ((5, 4, 60.0), (12, 4, 60.0), (28, 16, 25.0))
_PERCENTILES = (50, 95, 99)
# Skeletons are timed from the first bones on; none are learnt where tracks are timed.
_LEARN_S, _NEVER_S = 2.0, 60.0
_ROOM_S = 20.0
# Length of the take that is played again and again.
_LOOP_S = 60.0
# A person who is farther than this from all people of the finished session is not one of them.
_SAME_PERSON_M = 0.5


def latencies_ms(simulation: "Simulation", learn_s: float, slowness: float = 1.0) -> "tuple[np.ndarray, int]":
    """Time from the arrival of the frame that makes an instant final to the instant, and the number of dropped frames.

    Frames arrive at their times, and one core processes them in turn. Its processor time counts, so that other programs
    do not, times ``slowness``: as a core would take that is so many times slower.
    """
    capture = LiveCapture(
        simulation.cameras, simulation.joints, LiveSettings(simulation.timebase.frame_rate_hz, learn_s=learn_s)
    )
    taken_ms, free_s = [], -np.inf
    for frame in recorded_frames(simulation.cameras, simulation.times, simulation.detections):
        started_s = time.thread_time()
        instants = capture.push(*frame)
        free_s = max(free_s, frame.time_s) + slowness * (time.thread_time() - started_s)
        is_timed = learn_s == _NEVER_S or any(
            person.skeleton is not None for instant in instants for person in instant.people
        )
        if instants and is_timed:
            taken_ms.append(1e3 * (free_s - frame.time_s))
    return np.array(taken_ms), capture.counts.dropped


def measure_sizes(duration_s: float, slowness: float = 1.0) -> list[dict[str, Any]]:
    """Latencies at each size; ``p50_ms`` and so on are latencies of skeletons."""
    sizes = []
    for num_cameras, num_people, rate_hz in _SIZES:
        simulation = crowd(num_cameras, num_people, duration_s, rate_hz)
        size: dict[str, Any] = {"cameras": num_cameras, "people": num_people, "rate_hz": rate_hz, "dropped": 0}
        for prefix, learn_s in (("", _LEARN_S), ("tracks_", _NEVER_S)):
            taken_ms, num_dropped = latencies_ms(simulation, learn_s, slowness)
            values = np.percentile(taken_ms, _PERCENTILES).tolist()
            size |= {f"{prefix}p{share}_ms": value for share, value in zip(_PERCENTILES, values, strict=True)}
            size["dropped"] += num_dropped
        sizes.append(size)
    return sizes


def compare_with_finished(simulation: "Simulation") -> dict[str, Any]:
    """Mean errors of live skeletons and of the finished fit at the same joints and instants, and identity switches.

    A switch is a change of the live number of a person of the finished session.
    """
    cameras, timebase, joints = simulation.cameras, simulation.timebase, simulation.joints
    capture = LiveCapture(cameras, joints, LiveSettings(timebase.frame_rate_hz))
    frames = recorded_frames(cameras, simulation.times, simulation.detections)
    instants = [instant for frame in frames for instant in capture.push(*frame)] + capture.flush()
    parameters = derive_parameters(cameras, timebase.frame_rate_hz)
    people = reconstruct_tracks(cameras, simulation.times, simulation.detections, timebase, parameters)
    finished = animate(*people, cameras, timebase, joints, ReconstructionConfig()).tracks
    live_mm, fit_mm, numbers = [], [], {track.track_id: list[int]() for track in finished}
    for instant in instants:
        frame = round((instant.time_s - timebase.start_time_s) * timebase.frame_rate_hz)
        for live_m, number, has_skeleton, track in _paired(instant, finished, frame):
            numbers[track.track_id].append(number)
            truth_m = simulation.truth_m[:, frame]
            error_m = np.linalg.norm(
                np.stack([live_m, track.xyz_m[frame - track.start_frame]])[:, None] - truth_m, axis=-1
            )
            nearest_m = error_m[:, np.nanargmin(np.nanmean(error_m[1], axis=-1))]
            is_known = np.isfinite(nearest_m).all(0)
            if has_skeleton:
                live_mm += (1e3 * nearest_m[0, is_known]).tolist()
                fit_mm += (1e3 * nearest_m[1, is_known]).tolist()
    switches = sum(before != after for of_track in numbers.values() for before, after in pairwise(of_track))
    figures = {"live_mm": float(np.mean(live_mm)), "fit_mm": float(np.mean(fit_mm))}
    return {**figures, "ratio": figures["live_mm"] / figures["fit_mm"], "switches": switches}


def _paired(
    instant: "LiveInstant", finished: "tuple[Track3D, ...]", frame: int
) -> "list[tuple[np.ndarray, int, bool, Track3D]]":
    """People of an instant with the nearest person of the finished session: positions, number, has skeleton, track."""
    paired = []
    there = [track for track in finished if frame in track.frames]
    for person in instant.people:
        apart_m = [
            np.nanmean(np.linalg.norm(person.xyz_m - track.xyz_m[frame - track.start_frame], axis=-1))
            for track in there
        ]
        if apart_m and min(apart_m) < _SAME_PERSON_M:
            nearest = there[int(np.argmin(apart_m))]
            paired.append((person.xyz_m, person.id, person.skeleton is not None, nearest))
    return paired


def memory_mib(minutes: Sequence[int], num_people: int = 4, rate_hz: float = _SIZES[0][2]) -> dict[str, Any]:
    """Memory of this process after so many minutes of one capture, which is computed as fast as possible.

    A minute of five cameras is played forwards and backwards in turns, so that no person jumps.
    """
    simulation = crowd(_SIZES[0][0], num_people, _LOOP_S, rate_hz)
    frames = recorded_frames(simulation.cameras, simulation.times, simulation.detections)
    capture = LiveCapture(simulation.cameras, simulation.joints, LiveSettings(rate_hz))
    process = psutil.Process()
    by_minute: dict[str, float] = {}
    numbers: set[int] = set()
    for loop in range(max(minutes)):
        for frame in _turned(frames, loop):
            for instant in capture.push(*frame):
                numbers |= {person.id for person in instant.people}
        if loop + 1 in minutes:
            by_minute[str(loop + 1)] = process.memory_info().rss / 2**20
    return {"minutes": by_minute, "kept": capture.num_kept, "numbers": len(numbers), "dropped": capture.counts.dropped}


def _turned(frames: "Sequence[RecordedFrame]", loop: int) -> "Iterator[RecordedFrame]":
    """Frames of a loop of a minute: every second one runs backwards."""
    if loop % 2 == 0:
        yield from (frame._replace(time_s=frame.time_s + loop * _LOOP_S) for frame in frames)
        return
    last_s = frames[-1].time_s
    backwards = [frame._replace(time_s=last_s - frame.time_s + loop * _LOOP_S) for frame in frames]
    yield from sorted(backwards, key=lambda frame: (frame.time_s, frame.camera))


def live(
    duration_s: Annotated[float, typer.Option("--duration", min=3.0, max=600.0, help="Seconds of each size.")] = 20.0,
    slowness: Annotated[
        float, typer.Option(min=0.1, max=20.0, help="Time as on a core that is so many times slower.")
    ] = 1.0,
    minutes: Annotated[
        list[int] | None,
        typer.Option("--memory", min=1, max=600, help="Measure the memory after so many minutes of a capture instead."),
    ] = None,
    has_outputs: Annotated[
        bool, typer.Option("--outputs", help="Measure the delay that outputs to other programs add instead.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Time people and skeletons from a frame's arrival on one core, and compare them with a finished session."""
    if minutes:
        _report_memory(minutes, as_json)
        return
    if has_outputs:
        _report_outputs(duration_s, as_json)
        return
    with reporting(as_json):
        warm_up()
        sizes = measure_sizes(duration_s, slowness)
        room = compare_with_finished(record(replace(SCENES["room"], duration_s=_ROOM_S), 0))
    if as_json:
        emit({"sizes": sizes, "room": room})
        return
    columns = [name.replace("_", " ") for name in sizes[0]]
    print_table(columns, ([f"{value:.3g}" for value in size.values()] for size in sizes))
    typer.echo(
        f"Simulated room: error {room['live_mm']:.1f} mm live and {room['fit_mm']:.1f} mm of the finished fit, "
        f"{room['ratio']:.2f} times; {room['switches']} switches of identity."
    )


def _report_outputs(duration_s: float, as_json: bool) -> None:
    with reporting(as_json):
        warm_up()
        cases = measure_outputs(duration_s)
    if as_json:
        emit({"outputs": cases})
        return
    columns = [name.replace("_", " ") for name in cases[0]]
    print_table(columns, ([_shown(value) for value in case.values()] for case in cases))


def _shown(value: str | float | None) -> str:
    return value if isinstance(value, str) else "-" if value is None else f"{value:.3g}"


def _report_memory(minutes: Sequence[int], as_json: bool) -> None:
    with reporting(as_json):
        warm_up()
        memory = memory_mib(minutes)
    if as_json:
        emit({"memory": memory})
        return
    for minute, mib in memory["minutes"].items():
        typer.echo(f"{mib:.0f} MiB after {minute} minutes")
    typer.echo(
        f"{memory['numbers']} numbers of people, {memory['kept']} records kept, {memory['dropped']} frames dropped"
    )
