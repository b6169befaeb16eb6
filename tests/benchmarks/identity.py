"""Benchmark `identity`: time of the global pass over long takes, from tracks in memory to people in memory."""

import time
from dataclasses import replace
from typing import Annotated, Any

import typer

from api.cli.console import JsonOption, emit, print_table, reporting
from pipeline.association.identity.identify import identify
from pipeline.association.tracking.observations import gather
from pipeline.association.tracking.track_people import track_bodies
from pipeline.association.tracking.tracking_parameters import derive_parameters
from pipeline.core.data.cameras import Timebase
from pipeline.core.data.people import People
from pipeline.run.warm_up import warm_up
from pipeline.validation.simulation.motion.director import Cast, PlaceExchange
from pipeline.validation.simulation.rigs import Layout, Rig
from pipeline.validation.simulation.scenes import SCENES, Scene, record

_RIG = Rig(Layout.RING, 8, (5.5, 5.0), 2.6)
_DOORS_M = ((-4.5, -3.0), (4.5, 3.0), (0.0, 4.2))
_SCENES = {
    "ten people come and go": Scene(_RIG, Cast(10, (5.0, 4.0), walking=0.7, doors_m=_DOORS_M), duration_s=60.0),
    "seven people exchange places": replace(SCENES["exchange"], cast=PlaceExchange(7, gap_m=0.5), duration_s=60.0),
}
_REPEATS = 3


def measure_takes(minutes: int) -> list[dict[str, Any]]:
    """Time of the global pass over takes of a minute that are repeated, the best of several times."""
    takes = []
    for name, scene in _SCENES.items():
        simulation = record(scene, 0)
        cameras, timebase = simulation.cameras, simulation.timebase
        parameters = derive_parameters(cameras, timebase.frame_rate_hz)
        bodies = gather(cameras, simulation.times, simulation.detections)
        minute = track_bodies(cameras, simulation.times, bodies, timebase, parameters)
        tracks = [
            replace(track, start_frame=track.start_frame + k * timebase.num_frames)
            for k in range(minutes)
            for track in minute.tracks
        ]
        people = People(tracks, [*minute.observations] * minutes)
        whole = Timebase(0.0, timebase.frame_rate_hz, minutes * timebase.num_frames)
        best_s = float("inf")
        for _ in range(_REPEATS):
            started_s = time.perf_counter()
            found = identify(people, cameras, simulation.joints, whole, parameters.min_score)
            best_s = min(best_s, time.perf_counter() - started_s)
        takes.append(
            {
                "take": name,
                "minutes": minutes,
                "cameras": len(cameras),
                "tracks": len(tracks),
                "people": len(found.tracks),
                "seconds": best_s,
            }
        )
    return takes


def identity(
    minutes: Annotated[int, typer.Option(min=1, max=120, help="Length of the takes.")] = 10,
    as_json: JsonOption = False,
) -> None:
    """Time the global pass that tells who is who, from tracks in memory to people; simulated people."""
    with reporting(as_json):
        warm_up()
        takes = measure_takes(minutes)
    if as_json:
        emit({"takes": takes})
        return
    print_table(
        list(takes[0]),
        ([f"{value:.3g}" if isinstance(value, float) else str(value) for value in take.values()] for take in takes),
    )
