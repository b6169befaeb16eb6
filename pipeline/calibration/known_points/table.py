"""Known points as a table: CSV, a row for each view of a point."""

import csv
from collections.abc import Callable, Mapping
from math import isfinite
from pathlib import Path

from pipeline.core.errors import InputError, Problem
from pipeline.core.options.job_choices import MAX_KNOWN_POINTS, MAX_POINT_M, KnownPoint
from pipeline.core.problems.sessions import KNOWN_POINTS_INVALID
from pipeline.core.tables import open_table

COLUMNS = ("name", "x_m", "y_m", "z_m", "camera", "x_px", "y_px")
_MAX_BYTES = 4 << 20
_HINT = f"The first line names the columns {','.join(COLUMNS)}; each further line is a view of a point."


def read_known_points(path: Path) -> tuple[KnownPoint, ...]:
    """Read points from a table. Raises ``InputError`` with all problems of the table."""
    problems: list[Problem] = []
    points: dict[str, KnownPoint] = {}

    def invalid(message: str, hint: str | None = _HINT) -> None:
        problems.append(Problem(KNOWN_POINTS_INVALID, message, file=path.name, hint=hint))

    try:
        if path.stat().st_size > _MAX_BYTES:
            raise InputError([Problem(KNOWN_POINTS_INVALID, "The table is too large.", file=path.name)])
        with open_table(path) as table:
            if missing := table.missing(COLUMNS):
                invalid(f"The table lacks the columns {', '.join(missing)}.")
            for line, row in () if missing else table.rows:
                _add(points, row, line, invalid)
    except (OSError, ValueError, csv.Error):
        invalid("The table can't be read.")
    if len(points) > MAX_KNOWN_POINTS:
        invalid(f"The table has {len(points)} points; at most {MAX_KNOWN_POINTS} are taken.", None)
    if problems:
        raise InputError(problems)
    return tuple(points.values())


def _add(points: dict[str, KnownPoint], row: Mapping[str, str], line: int, invalid: Callable[..., None]) -> None:
    name, camera = row["name"], row["camera"]
    try:
        x_m, y_m, z_m, x_px, y_px = (float(row[column]) for column in COLUMNS if column not in {"name", "camera"})
    except ValueError:
        invalid(f"Line {line} has something else than a number in its columns of coordinates.")
        return
    if not name or not camera:
        invalid(f"Line {line} lacks the name of a point or of a camera.")
    elif not all(map(isfinite, (x_px, y_px))) or not all(abs(value) <= MAX_POINT_M for value in (x_m, y_m, z_m)):
        invalid(f"Line {line} has a coordinate that is not finite, or is farther than {MAX_POINT_M:g} m away.", None)
    elif (known := points.get(name)) is not None and known.xyz_m != (x_m, y_m, z_m):
        invalid(
            f"Line {line} gives the point {name} other coordinates than an earlier line.", "Give it the same in all."
        )
    else:
        seen = () if known is None else known.seen_px
        points[name] = KnownPoint(name, (x_m, y_m, z_m), (*seen, (camera, x_px, y_px)))
