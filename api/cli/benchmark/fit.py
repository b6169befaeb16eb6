"""`multicap benchmark fit`: speed and memory of the skeleton fit, from tracks in memory to motions."""

import tracemalloc
from dataclasses import fields, replace
from functools import partial
from typing import Annotated, Any

import typer

from api.cli.benchmark.tracking import shortest_s
from api.cli.console import JsonOption, emit, reporting, show_sizes, shows_help
from pipeline.core.options.config import ReconstructionConfig

if not shows_help():
    import numpy as np

    from api.cli.benchmark.long_takes import longer_observations, longer_track
    from pipeline.association.tracking.track_people import reconstruct_tracks
    from pipeline.association.tracking.tracking_parameters import derive_parameters
    from pipeline.core.data.animation import SkeletonMotion
    from pipeline.core.data.cameras import Timebase
    from pipeline.core.data.people import Observations, Track3D
    from pipeline.motion.skeleton.animate import animate
    from pipeline.run.warm_up import warm_up
    from pipeline.validation.simulation.scenes import SCENES, record

# Scenes, of 3 and of 4 people, and numbers of cameras.
_SIZES = (("room", 4), ("store", 12))
_DURATION_S = 20.0
_REPEATS = 3
_MINUTES = (3.0, 30.0)
_MIB = 2**20


def measure_sizes() -> list[dict[str, Any]]:
    """Person-frames a second at each size, the best of several times."""
    sizes = []
    for scene, num_cameras in _SIZES:
        simulation = record(replace(SCENES[scene], duration_s=_DURATION_S), 0, num_cameras)
        cameras, timebase = simulation.cameras, simulation.timebase
        parameters = derive_parameters(cameras, timebase.frame_rate_hz)
        people = reconstruct_tracks(cameras, simulation.times, simulation.detections, timebase, parameters)
        fitted = partial(animate, *people, cameras, timebase, simulation.joints, ReconstructionConfig())
        best_s = shortest_s(fitted, _REPEATS)
        person_frames = sum(track.num_frames for track in people[0])
        sizes.append(
            {"cameras": num_cameras, "people": len(simulation.truth_m), "person_frames_per_s": person_frames / best_s}
        )
    return sizes


def measure_memory() -> list[dict[str, float]]:
    """Peak memory of the fit of one person, without its input and output, by the length of the take."""
    simulation = record(replace(SCENES["room"], duration_s=_DURATION_S), 0, _SIZES[0][1])
    cameras, rate_hz = simulation.cameras, simulation.timebase.frame_rate_hz
    people = reconstruct_tracks(
        cameras, simulation.times, simulation.detections, simulation.timebase, derive_parameters(cameras, rate_hz)
    )
    track, seen = max(zip(*people, strict=True), key=lambda person: person[0].num_frames)
    figures = []
    for minutes in _MINUTES:
        num_frames = round(60 * minutes * rate_hz)
        long_track, long_seen = longer_track(track, num_frames), longer_observations(seen, num_frames)
        timebase = Timebase(0.0, rate_hz, num_frames)
        tracemalloc.start()
        animation = animate([long_track], [long_seen], cameras, timebase, simulation.joints, ReconstructionConfig())
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        given, made = _arrays(long_track, long_seen), _arrays(*animation.tracks, *animation.motions)
        # Arrays that an output shares with the input are not counted as new.
        num_new = sum(array.nbytes for key, array in made.items() if key not in given)
        num_all = sum(array.nbytes for array in (given | made).values())
        figures.append({"minutes": minutes, "records_mib": num_all / _MIB, "working_mib": (peak - num_new) / _MIB})
    return figures


def _arrays(*records: "Track3D | Observations | SkeletonMotion") -> "dict[int, np.ndarray]":
    values = (getattr(record, field.name) for record in records for field in fields(record))
    return {id(value): value for value in values if isinstance(value, np.ndarray)}


def fit(
    memory: Annotated[bool, typer.Option("--memory", help="Also measure the memory of long takes (minutes).")] = False,
    as_json: JsonOption = False,
) -> None:
    """Time the fit of skeletons to whole tracks on one core; simulated people, detected as whole bodies."""
    with reporting(as_json):
        warm_up()
        sizes = measure_sizes()
        figures = {"memory": measure_memory()} if memory else {}
    if as_json:
        emit({"sizes": sizes} | figures)
        return
    show_sizes(sizes, as_json)
    for figure in figures.get("memory", ()):
        typer.echo(
            f"{figure['minutes']:g} minutes of one person: {figure['working_mib']:.0f} MiB beside "
            f"{figure['records_mib']:.0f} MiB of records"
        )
