"""Declaration of a reader of 3D points, and the table that it gives."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from pipeline.core.options.job_choices import Up
from pipeline.core.runtime.plugins import FormatReader

MAX_NUMBERS = 2**27
"""Limit on the numbers of a file: a gigabyte in memory."""


@dataclass(frozen=True, slots=True, eq=False)
class PointTable:
    """Points of a file over time. A name may have the name of its person and a colon in front."""

    names: tuple[str, ...]
    xyz: Float[np.ndarray, "frames points 3"]  # In the file's unit and axes, NaN where a point is unknown
    rate_hz: float | None = None  # ``None``: the file does not state it
    unit: str | None = None  # m, cm or mm; for others the people tell it
    up: Up = "z"  # Axis that usually points up, which standing people confirm
    start_s: float = 0.0
    # Orientations of segments by label (``SEGMENT_LABELS`` of the joint angles) in the file's axes; NaN where unknown
    world_from_segment: Mapping[str, Float[np.ndarray, "frames 3 3"]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class PointReader(FormatReader):
    """Reader of a format of 3D points, by the endings of its files; ``read`` raises ``KeypointsError``, or anything."""

    read: Callable[[Path], PointTable]
    suffixes: tuple[str, ...]


def point_reader(name: str, *suffixes: str) -> Callable[[Callable[[Path], PointTable]], PointReader]:
    """Declare a function as the reader of a format, by the endings of its files; "" is a folder."""
    return lambda read: PointReader(name, read, suffixes)


def flattened(people: Any, names: tuple[str, ...], xyz: Float[np.ndarray, "frames people points 3"]) -> dict[str, Any]:
    """Names and places of a table of several people, who are named."""
    return {
        "names": tuple(f"{person}:{name}" for person in people for name in names),
        "xyz": xyz.reshape(len(xyz), -1, 3),
    }
