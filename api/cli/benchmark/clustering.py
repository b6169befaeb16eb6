"""`multicap benchmark clustering`: speed of clustering, from peaks and fields in memory to poses."""

import time
from dataclasses import replace
from typing import Any

from api.cli.console import JsonOption, reporting, show_sizes, shows_help
from pipeline.association.clustering.instant.work_limits import WorkLimits
from pipeline.core.joints import COCO_18

if not shows_help():
    import numpy as np

    from pipeline.association.clustering.cluster_people import find_poses, first_lengths, sampled_frames
    from pipeline.association.clustering.clustering_parameters import derive_parameters
    from pipeline.association.clustering.instant.candidates import FieldEvidence
    from pipeline.association.clustering.skeleton import clustering_skeleton
    from pipeline.geometry.camera import image_from_world
    from pipeline.run.warm_up import warm_up
    from pipeline.validation.simulation.scenes import SCENES, Simulation, record
    from pipeline.validation.simulation.views.fields import GRID, render

# Scenes (of 4 and of 7 people) and numbers of cameras.
_SIZES = (("noisy", 5), ("crowd", 12))
_DURATION_S = 2.0
_REPEATS = 3


def _poses_s(simulation: "Simulation") -> float:
    """Shortest of several times for all frames, with known bone lengths of all people."""
    cameras, timebase = simulation.cameras, simulation.timebase
    parameters = derive_parameters(cameras, GRID.tau2)
    skeleton = clustering_skeleton(COCO_18)
    projections = np.array([image_from_world(camera) for camera in cameras])
    fields = render(simulation.sketches, simulation.times, (-np.inf, np.inf))
    seen = FieldEvidence(cameras, simulation.times, fields, timebase, skeleton, parameters)
    sampled = [(seen, sampled_frames(timebase, parameters))]
    lengths = first_lengths(cameras, sampled, timebase, skeleton, parameters)
    instants = [seen.at(frame) for frame in range(timebase.num_frames)]
    best_s = np.inf
    for _ in range(_REPEATS):
        started_s = time.perf_counter()
        for instant in instants:
            find_poses(projections, instant, skeleton, lengths, parameters, WorkLimits())
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
    as_json: JsonOption = False,
) -> None:
    """Time clustering on one core, from peaks and fields in memory to poses in memory; simulated people."""
    with reporting(as_json):
        warm_up()
        sizes = measure_sizes()
    show_sizes(sizes, as_json)
