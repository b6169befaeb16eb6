"""Force plates of a laboratory's file in the world: forces, moments and centres of pressure.

Types 1 to 5 of the C3D format are read. The axes of a plate follow from its corners: X points from the middle of
corners 2 and 3 to the middle of corners 1 and 4, Y from the middle of 3 and 4 to the middle of 1 and 2, Z into the
floor.
Programs write either the force of the feet or its reaction: the sign is chosen that makes the floor push upwards.
``FORCE_PLATFORM:ZERO`` is subtracted, and units of moments are honoured.
"""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from pipeline.core.data.laboratory import ForcePlate, Laboratory

UNITS_M: Mapping[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001}
"""Metres of the units of lengths."""

LOADED_N = 20.0
"""Vertical force from which on a plate is loaded."""

# Files have left-over bytes as corners of plates that were not there.
_LARGEST_M = 20.0
_NUM_CHANNELS = {1: 6, 2: 6, 3: 8, 4: 6, 5: 8}


def plate_corners_m(laboratory: Laboratory) -> Float[np.ndarray, "plates 4 3"]:
    """Corners of the plates in the world."""
    used = laboratory.numbers("FORCE_PLATFORM", "USED")
    corners = laboratory.numbers("FORCE_PLATFORM", "CORNERS").reshape(-1, 4, 3)[: int(used.flat[0]) if used.size else 0]
    return laboratory.world_from_laboratory.apply(corners.astype(float) * UNITS_M[laboratory.unit])


def force_plates(laboratory: Laboratory) -> tuple[ForcePlate, ...]:
    """Plates of a laboratory whose types are known and whose corners are a plate's, in the file's order."""
    types = laboratory.numbers("FORCE_PLATFORM", "TYPE").astype(int)
    return tuple(
        _plate(laboratory, number, int(types[number]), corners_m)
        for number, corners_m in enumerate(plate_corners_m(laboratory))
        if int(types[number]) in _NUM_CHANNELS and np.isfinite(plate_axes(corners_m)).all()
    )


def _plate(laboratory: Laboratory, number: int, kind: int, corners_m: Float[np.ndarray, "4 3"]) -> ForcePlate:
    columns = laboratory.numbers("FORCE_PLATFORM", "CHANNEL")[number, : _NUM_CHANNELS[kind]].astype(int) - 1
    if columns.min() < 0:
        raise ValueError("a plate lacks a channel")
    origins, own = laboratory.numbers("FORCE_PLATFORM", "ORIGIN"), UNITS_M[laboratory.unit]
    origin_m = (origins[number] if len(origins) else np.zeros(3)) * own
    values = np.stack([laboratory.channel(column) for column in columns])
    if kind != 1:
        values = values - _zero(laboratory, values)[:, None]
    if kind in {4, 5}:
        matrix = laboratory.numbers("FORCE_PLATFORM", "CAL_MATRIX")[number].T[: 6 if kind == 4 else 8]
        values = matrix @ values if kind == 4 else matrix[: len(values)].T @ values
        factor = np.where(np.arange(len(values)) < 3, 1.0, own)
        kind = 2
    else:
        units = [*laboratory.texts("ANALOG", "UNITS"), *[""] * (max(columns) + 1)]
        factor = np.array([_length_m(units[column], own) for column in columns])
        values = values * [[1000.0 if units[column].lower().startswith("kn") else 1.0] for column in columns]
    force, moment = _force_and_moment(kind, values, factor, origin_m)
    axes = plate_axes(corners_m)
    force_n, moment_nm = force.T @ axes.T, moment.T @ axes.T
    loaded = np.abs(force_n[:, 2]) > LOADED_N
    if force_n[loaded, 2].sum() < 0.0:
        force_n, moment_nm = -force_n, -moment_nm
    pressure_m = np.full(force_n.shape, np.nan)
    place_m = np.stack([-moment[1], moment[0]], axis=1)[loaded] / force[2][loaded, None]
    pressure_m[loaded] = corners_m.mean(0) + place_m @ axes[:, :2].T
    return ForcePlate(corners_m, force_n, moment_nm, pressure_m)


def _zero(laboratory: Laboratory, values: Float[np.ndarray, "channels samples"]) -> Float[np.ndarray, " channels"]:
    """Mean of the channels in the frames of ``ZERO``, counted from 1; 0 without any."""
    frames = laboratory.numbers("FORCE_PLATFORM", "ZERO").astype(int)
    if frames.size < 2 or not 1 <= frames[0] <= frames[1] <= laboratory.num_frames:
        return np.zeros(len(values))
    per_frame = laboratory.samples_per_frame
    return np.asarray(values[:, (frames[0] - 1) * per_frame : frames[1] * per_frame].mean(1))


def _length_m(unit: str, otherwise: float) -> float:
    """Metres of the length in a channel's unit, such as ``Nmm``; 1 of forces and volts."""
    letters = "".join(filter(str.isalpha, unit)).lower().removeprefix("k")
    return 1.0 if letters in {"n", "v", "mv"} else UNITS_M.get(letters.removeprefix("n"), otherwise)


def _force_and_moment(
    kind: int, values: Float[np.ndarray, "channels samples"], factor: np.ndarray, origin_m: np.ndarray
) -> tuple[Float[np.ndarray, "3 samples"], Float[np.ndarray, "3 samples"]]:
    """Force, and moment about the middle of the surface, along a plate's axes."""
    if kind == 3:
        (x12, x34, y14, y23, z1, z2, z3, z4), (a, b, depth) = values, origin_m
        force = np.stack([x12 + x34, y14 + y23, z1 + z2 + z3 + z4])
        turning = a * (y14 - y23) + b * (x34 - x12)
        moment = np.stack([b * (z1 + z2 - z3 - z4), a * (z2 + z3 - z1 - z4), turning])
        origin_m = np.array([0.0, 0.0, depth])
    else:
        force, moment = values[:3], values[3:] * factor[3:, None]
        if kind == 1:
            x, y, turning = moment
            return force, np.stack([y * force[2], -x * force[2], x * force[1] - y * force[0] + turning])
    # The sensors lie below the surface, whatever sign a program gives the origin.
    to_surface = -origin_m if origin_m[2] > 0.0 else origin_m
    return force, moment - np.cross(to_surface, force, axisb=0).T


def plate_axes(corners_m: Float[np.ndarray, "4 3"]) -> Float[np.ndarray, "3 3"]:
    """Axes of a plate in the world, by columns; NaN if the corners span no area, or are numbers of another kind."""
    first, second, third, fourth = np.where(np.ptp(corners_m, 0).max() < _LARGEST_M, corners_m, np.nan)
    x, y = first + fourth - second - third, first + second - third - fourth
    z = np.cross(x, y)
    with np.errstate(invalid="ignore"):
        x, z = x / np.linalg.norm(x), z / np.linalg.norm(z)
    return np.stack([x, np.cross(z, x), z], axis=1)
