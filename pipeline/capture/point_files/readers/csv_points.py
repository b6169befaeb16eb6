"""Reader of CSV files with columns such as ``left_knee_x_m``: ours, FreeMoCap's, anipose's, and tables of one's own.

DeepLabCut's 3D files have rows of headers instead: scorer, individuals (of several people), body parts and coordinates.
"""

import csv
import re
from io import StringIO
from itertools import chain
from pathlib import Path

import numpy as np

from pipeline.capture.keypoint_files.people import KeypointsError
from pipeline.capture.point_files.point_reader import PointTable, point_reader
from pipeline.video.frame_rate import measured_rate_hz

_COLUMN = re.compile(r"(?P<name>.*?)[ _.:]?(?P<axis>[xyz])(?:[ _]?\(?(?P<unit>m|cm|mm)\)?)?", re.IGNORECASE)
_TIMES = ("time_s", "time", "t", "timestamp")


@point_reader("CSV", ".csv")
def read_csv(path: Path) -> PointTable:
    """Read a file: a line of headers, or DeepLabCut's rows of them, then a row a frame."""
    head, _, rest = path.read_text("utf-8-sig").partition("\n")
    separator = next((mark for mark in (";", "\t") if mark in head), ",")

    def cells(line: str) -> list[str]:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=separator, skipinitialspace=True))]

    columns = cells(head)
    if columns[:1] == ["scorer"]:
        *heads, rest = rest.split("\n", 2 + rest.startswith("individuals"))
        columns = [f"{':'.join(names)}_{axis}" for *names, axis in zip(*map(cells, heads), strict=True)]
    if separator != ",":
        # Spreadsheets of languages with a decimal comma write numbers so.
        rest = rest.replace(",", ".")
    values = np.genfromtxt(StringIO(rest), delimiter=separator, ndmin=2)
    places: dict[str, dict[str, int]] = {}
    units = set()
    for number, column in enumerate(columns):
        if (found := _COLUMN.fullmatch(column)) and found["name"]:
            if places.setdefault(found["name"], {}).setdefault(found["axis"].lower(), number) != number:
                raise KeypointsError(f"The file has more than one column {column}.")
            units.add(found["unit"] and found["unit"].lower())
    if len(units - {None}) > 1:
        raise KeypointsError(f"The columns have the units {', '.join(sorted(units - {None}))}: write all of them in m.")
    whole = {name: [axes[axis] for axis in "xyz"] for name, axes in places.items() if len(axes) == 3}
    if not whole:
        raise KeypointsError("The file has no columns such as left_knee_x, left_knee_y and left_knee_z.")
    time = next((columns.index(name) for name in _TIMES if name in columns), None)
    time_s = np.zeros(0) if time is None else values[:, time]
    return PointTable(
        tuple(whole),
        values[:, list(chain.from_iterable(whole.values()))].reshape(len(values), -1, 3),
        measured_rate_hz(time_s) if len(time_s) > 1 else None,
        units.pop() if len(units) == 1 else None,
        start_s=float(time_s[0]) if len(time_s) else 0.0,
    )
