"""`multicap benchmark clustering`: frames a second of the 3D stage, from candidates in memory to poses."""

import time
from dataclasses import replace
from typing import Annotated, Any

import numpy as np
import typer
from rich.table import Table

from api.console import console, emit, reporting
from pipeline.clustering.associate import find_poses
from pipeline.clustering.bone_lengths import measure_lengths, unknown_lengths
from pipeline.clustering.candidates import Seen
from pipeline.clustering.linking import link
from pipeline.clustering.parameters import derive_parameters
from pipeline.clustering.skeleton import TORSO, skeleton_of
from pipeline.geometry.camera import image_from_world
from pipeline.simulation.scenes import SCENES, Simulation, record

# Scenes (of 4 and of 7 people) and numbers of cameras.
_SIZES = (("noisy", 5), ("crowd", 12))
_DURATION_S = 2.0
_REPEATS = 3


def _poses_s(simulation: Simulation) -> float:
    """Seconds for all frames with everybody's bone lengths known, the shortest of several times."""
    parameters = derive_parameters(simulation.cameras)
    skeleton = skeleton_of(simulation.joints)
    projections = np.array([image_from_world(camera) for camera in simulation.cameras])
    seen = Seen(simulation.cameras, simulation.times, simulation.detections, skeleton, parameters.min_score)
    base = simulation.timebase
    instants_s = base.start_time_s + np.arange(base.num_frames) / base.frame_rate_hz
    candidates = [seen.at(time_s, 0.5 / base.frame_rate_hz) for time_s in instants_s.tolist()]
    unknown = unknown_lengths(skeleton)
    first = [find_poses(projections, one, skeleton, unknown, parameters) for one in candidates]
    torso = skeleton.indices(TORSO)
    lives = link([one.xyz_m[:, torso] for one in first], instants_s, parameters)
    lengths = measure_lengths([np.array([first[at].xyz_m[k] for at, k in life.members]) for life in lives], skeleton)
    best_s = np.inf
    for _ in range(_REPEATS):
        started_s = time.perf_counter()
        for one in candidates:
            find_poses(projections, one, skeleton, lengths, parameters)
        best_s = min(best_s, time.perf_counter() - started_s)
    return best_s


def measure_sizes() -> list[dict[str, Any]]:
    """Frames a second at each size; a frame counts when all cameras were updated once."""
    sizes = []
    for scene, num_cameras in _SIZES:
        simulation = record(replace(SCENES[scene], duration_s=_DURATION_S), 0, num_cameras)
        fps = simulation.timebase.num_frames / _poses_s(simulation)
        sizes.append({"cameras": num_cameras, "people": len(simulation.truth_m), "fps": fps})
    return sizes


def clustering(
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
) -> None:
    """Time clustering on one core, from whole bodies' joints in memory to poses in memory; simulated people."""
    with reporting(as_json):
        sizes = measure_sizes()
    if as_json:
        emit({"sizes": sizes})
        return
    table = Table("cameras", "people", "frames a second")
    for size in sizes:
        table.add_row(str(size["cameras"]), str(size["people"]), f"{size['fps']:.1f}")
    console.print(table)
