"""Estimated forces of the feet as force plates of a C3D file: a plate of type 2 for each foot.

A plate is a rectangle of the floor around all places that the foot presses. Its channels are the force of the foot on
the plate and the moment about the middle of its corners, along axes whose Z points into the floor, as force plates
write them. Labels and descriptions say that they are estimated. Samples are 0 where the force or its place is unknown.
"""

import numpy as np

from pipeline.core.data.cameras import Timebase
from pipeline.core.data.laboratory import Groups, Laboratory
from pipeline.core.data.rigid import Rigid3
from pipeline.core.joints import SIDES
from pipeline.export.timelines import unknown_outside
from pipeline.motion.forces.person_forces import PersonForces
from pipeline.motion.laboratory.plates import plate_axes

_MM_PER_M = 1000.0
_MARGIN_M = 0.2
# Corners 1 to 4, clockwise from above: Z points down.
_CORNERS = np.array([(1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0)])
_CHANNELS = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")


def estimated_plates(forces: PersonForces, timebase: Timebase, frames: range) -> Laboratory | None:
    """Plates under a person's feet, with a sample for each frame of a file; ``None`` if no foot ever stands."""
    feet = forces.in_newtons().feet
    corners_m, columns, labels, descriptions = [], [], [], []
    for number, side in enumerate(SIDES):
        pressure_m = feet.pressure_m[:, number]
        known = feet.stands[:, number] & np.isfinite(pressure_m).all(1) & np.isfinite(feet.force[:, number]).all(1)
        if not known.any():
            continue
        low_m, high_m = pressure_m[known].min(0), pressure_m[known].max(0)
        middle_m, half_m = (low_m + high_m) / 2.0, (high_m - low_m)[:2] / 2.0 + _MARGIN_M
        corners_m.append(middle_m + np.pad(_CORNERS * half_m, [(0, 0), (0, 1)]))
        ground_n = np.where(known[:, None], feet.force[:, number], 0.0)
        moment_nm = np.cross(np.where(known[:, None], pressure_m - middle_m, 0.0), ground_n)
        moment_nm[:, 2] += np.where(known, feet.free_moment[:, number], 0.0)
        axes = plate_axes(corners_m[-1])
        columns += [-ground_n @ axes, -moment_nm @ axes * _MM_PER_M]
        labels += [f"{side}_{channel}_estimated" for channel in _CHANNELS]
        descriptions.append(f"{side} foot, estimated without a plate; {forces.mass}")
    if not columns:
        return None
    samples = np.nan_to_num(unknown_outside(np.concatenate(columns, axis=1), forces.frames, frames))
    num_plates, num_channels = len(corners_m), len(labels)
    groups: Groups = {
        "ANALOG": {
            "USED": np.array([num_channels], "u2"),
            "LABELS": labels,
            "DESCRIPTIONS": [text for text in descriptions for _ in _CHANNELS],
            "UNITS": ["N", "N", "N", "Nmm", "Nmm", "Nmm"] * num_plates,
            "SCALE": np.ones(num_channels, "f4"),
            "OFFSET": np.zeros(num_channels, "u2"),
            "GEN_SCALE": np.ones(1, "f4"),
        },
        "FORCE_PLATFORM": {
            "USED": np.array([num_plates], "u2"),
            "TYPE": np.full(num_plates, 2, "u2"),
            "ZERO": np.array([1, 0], "u2"),
            "CORNERS": np.stack(corners_m) * _MM_PER_M,
            "ORIGIN": np.zeros((num_plates, 3), "f4"),
            "CHANNEL": np.arange(1, num_channels + 1, dtype="u2").reshape(num_plates, len(_CHANNELS)),
            "DESCRIPTIONS": descriptions,
        },
    }
    world, values = Rigid3(np.eye(3), np.zeros(3)), samples.astype(np.float32)
    return Laboratory("", "mm", timebase.frame_rate_hz, len(frames), 1, values, groups, (), world)
