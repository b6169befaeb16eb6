"""`multicap benchmark fit`: person-frames a second of the fit, from tracks in memory to tracks in memory."""

import time
from dataclasses import replace
from typing import Annotated, Any

import numpy as np
import typer

from api.console import reporting, show_sizes
from pipeline.config import ReconstructionConfig
from pipeline.simulation.scenes import SCENES, record
from pipeline.skeleton.animate import animate
from pipeline.tracking.associate import reconstruct_tracks
from pipeline.tracking.parameters import derive_parameters
from pipeline.warm_up import warm_up

# Scenes, of 3 and of 4 people, and numbers of cameras.
_SIZES = (("room", 4), ("store", 12))
_DURATION_S = 20.0
_REPEATS = 3


def measure_sizes() -> list[dict[str, Any]]:
    """Person-frames a second at each size, the best of several times."""
    sizes = []
    for scene, num_cameras in _SIZES:
        simulation = record(replace(SCENES[scene], duration_s=_DURATION_S), 0, num_cameras)
        cameras, timebase = simulation.cameras, simulation.timebase
        parameters = derive_parameters(cameras, timebase.frame_rate_hz)
        found = reconstruct_tracks(cameras, simulation.times, simulation.detections, timebase, parameters)
        best_s = np.inf
        for _ in range(_REPEATS):
            started_s = time.perf_counter()
            animate(*found, cameras, timebase, simulation.joints, ReconstructionConfig())
            best_s = min(best_s, time.perf_counter() - started_s)
        person_frames = sum(track.num_frames for track in found[0])
        sizes.append(
            {"cameras": num_cameras, "people": len(simulation.truth_m), "person_frames_per_s": person_frames / best_s}
        )
    return sizes


def fit(
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
) -> None:
    """Time the fit of joints over whole tracks on one core; simulated people, detected in whole bodies."""
    with reporting(as_json):
        warm_up()
        sizes = measure_sizes()
    show_sizes(sizes, as_json)
