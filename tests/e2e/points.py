"""Files of 3D points that another system has located, with the truth of a simulated walk."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from pipeline.validation.simulation.scenes import find_scene, record


def write_walk(folder: Path, duration_s: float = 2.0) -> list[Path]:
    """CSV files of the people of a walk, with times and in centimetres."""
    simulation = record(replace(find_scene("walk"), duration_s=duration_s), seed=1, num_views=2)
    times_s = np.arange(simulation.timebase.num_frames) / simulation.timebase.frame_rate_hz
    head = ["time_s", *(f"{name}_{axis}_cm" for name in simulation.joints.names for axis in "xyz")]
    paths = [folder / f"walker-{k + 1}.csv" for k in range(len(simulation.truth_m))]
    for path, truth_m in zip(paths, simulation.truth_m, strict=True):
        table = np.column_stack([times_s, 100 * truth_m.reshape(len(times_s), -1)])
        np.savetxt(path, table, delimiter=",", header=",".join(head), comments="")
    return paths
