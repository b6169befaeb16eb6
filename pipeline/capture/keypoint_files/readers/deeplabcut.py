"""Reader of DeepLabCut's CSV: a row a frame, below three or four rows of headers.

The rows of headers begin with ``scorer``, ``individuals`` (files of several people only), ``bodyparts`` and ``coords``
(x, y, and ``likelihood`` in analysed videos). A row begins with the number of the frame, or with the path of a picture
whose name has that number. Parts that stand once in a scene, under the individual ``single``, belong to no person.
Format:
https://deeplabcut.github.io/DeepLabCut (standard user guide, outputs of ``analyze_videos``)

Rows of the table of formats:

| DeepLabCut | all frames: CSV of one person (three rows of headers) or of several (four), or the same as HDF5 | joints
whose names are known, and points of your own | parts of `single` belong to no person; of a CSV and an HDF5 file of one
name the CSV is read |
"""

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from pipeline.capture.keypoint_files.keypoint_reader import reader
from pipeline.capture.keypoint_files.own_points import MAX_OWN, point_names
from pipeline.capture.keypoint_files.people import (
    KeypointsError,
    People,
    check_frames,
    check_number,
    frame_number,
    number_in_name,
)
from pipeline.capture.keypoint_files.points import KeypointReading, named_layout
from pipeline.core.layouts import KeypointLayout
from pipeline.core.parsing import UnreadableError

_MAX_LINE = 4 * 2**20
_HEADERS = ("scorer", "individuals", "bodyparts", "coords")
_COORDS = ("x", "y", "likelihood")
_SCENE = "single"


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """Columns of a file."""

    names: Sequence[str]  # Name of each column as messages show it; empty for those before the points
    parts: Sequence[str]  # Name of each point
    # Column of each number: individuals, points of the layout, and x, y and likelihood; -1 without one
    number: Int[np.ndarray, "people points 3"]
    layout: KeypointLayout  # Layout of the points
    num_leading: int  # Columns before the points
    # Points that stand once in the scene: their names, and the column of each number
    scene: Sequence[str]
    scene_number: Int[np.ndarray, "points 3"]

    def points(self, values: Float[np.ndarray, "*rows columns"], number: np.ndarray) -> np.ndarray:
        """Points in ``number``'s shape for rows of values, behind which a column of NaN stands."""
        points = values[..., number]
        points[..., number[..., 2] < 0, 2] = 1.0
        return points


def split_frames(content: bytes) -> Mapping[int, tuple[Columns, str]]:
    """Split the rows by the number of their frame.

    Raises ``KeypointsError`` if the headers can't be used, or if a row has no number, or another row's;
    ``UnreadableError`` if the content is no text.
    """
    if content.removeprefix(b"\xef\xbb\xbf").lstrip(b'"')[:6].lower() != b"scorer":
        raise KeypointsError("The CSV file does not begin with the row scorer of DeepLabCut.")
    try:
        lines = content.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise UnreadableError from error
    check_frames(len(lines))
    if any(len(line) > _MAX_LINE for line in lines):
        raise KeypointsError(f"A row is longer than {_MAX_LINE // 2**20} MiB.")
    headers: dict[str, list[str]] = {}
    while lines and "coords" not in headers:
        name, *cells = _cells(lines.pop(0)) or [""]
        if name.lower() not in _HEADERS:
            raise KeypointsError("The headers must be scorer, individuals (if there are several), bodyparts, coords.")
        headers[name.lower()] = ["", *cells]
    columns = find_columns(headers)
    frames: dict[int, tuple[Columns, str]] = {}
    for line in lines:
        if not line.strip(","):
            continue
        number = _split_number(line, columns.num_leading)
        if number in frames:
            raise KeypointsError(f"Frame {number} is listed twice.", "frame")
        frames[number] = columns, line
    return frames


@reader("DeepLabCut", suffixes=(".csv",), load=Path.read_bytes, split_frames=split_frames)
def read_frame(content: tuple[Columns, str], reading: KeypointReading) -> People:
    """Read the people of a row with at least one detected joint.

    Raises ``KeypointsError`` or ``CrowdError`` if the row can't be used.
    """
    columns, line = content
    cells = _cells(line)
    if len(cells) != len(columns.names):
        raise KeypointsError(f"The row has {len(cells)} cells; the headers have {len(columns.names)}.")
    # One more value for numbers without a column: NaN for a position, 1 for a likelihood.
    values = np.full(len(cells) + 1, np.nan)
    for k in range(columns.num_leading, len(cells)):
        try:
            values[k] = float(cells[k]) if cells[k].strip() else np.nan
        except ValueError:
            message = f"{cells[k][:40]!r} is not a number."
            raise KeypointsError(message, columns.names[k]) from None
    if columns.scene:
        scene = columns.points(values, columns.scene_number)
        reading.add_own(columns.scene, scene[None][:0], scene[None], scene[None][:0])
    return reading.people(columns.points(values, columns.number), columns.layout)


def find_columns(headers: Mapping[str, Sequence[str]]) -> Columns:
    """Columns of the points that are joints, by the rows of headers, which have an entry for each column.

    Raises ``KeypointsError`` if the headers can't be used.
    """
    if not {"bodyparts", "coords"} <= headers.keys():
        raise KeypointsError("The rows of headers bodyparts and coords are missing.")
    if len({len(cells) for cells in headers.values()}) > 1:
        raise KeypointsError("The rows of headers have different numbers of cells.")
    coords = [coord.strip().lower() for coord in headers["coords"]]
    parts = headers["bodyparts"]
    owners = headers.get("individuals", [""] * len(coords))
    points = [k for k, coord in enumerate(coords) if coord in _COORDS]
    people = list(dict.fromkeys(owners[k] for k in points))
    if len(people) > 1 and _SCENE in people:
        people.remove(_SCENE)
    check_number(people)
    of_people = set(people)
    names = list(dict.fromkeys(parts[k] for k in points if owners[k] in of_people))
    layout = named_layout(names, "bodyparts")
    scene = list(dict.fromkeys(parts[k] for k in points if owners[k] not in of_people))[: MAX_OWN + 1]
    number = np.full((len(people) + 1, max(len(names), len(scene)), len(_COORDS)), -1)
    places = {(owner, name): (k, place) for k, owner in enumerate(people) for place, name in enumerate(names)}
    places |= {(_SCENE, name): (len(people), place) for place, name in enumerate(scene)}
    shown = [""] * len(coords)
    for k in points:
        shown[k] = " ".join(part for part in (owners[k], parts[k], coords[k]) if part)
        if (owners[k], parts[k]) not in places:
            continue
        place = *places[owners[k], parts[k]], _COORDS.index(coords[k])
        if number[place] >= 0:
            raise KeypointsError("Two columns have the same headers.", shown[k])
        number[place] = k
    of_scene = number[-1, : len(scene)]
    return Columns(shown, names, number[:-1, : len(names)], layout, points[0], point_names(scene), of_scene)


def _split_number(line: str, num_leading: int) -> int:
    """Number of a row's frame: the first cell, or the number in the name of the picture in the leading cells."""
    first = line.split(",", 1)[0].strip('"')
    if num_leading == 1 and first.isascii() and first.isdecimal() and len(first) <= 300:
        return frame_number(int(first), "frame")
    number = number_in_name(_cells(line)[:num_leading][-1])
    return frame_number(first if number is None else number, "frame")


def _cells(line: str) -> list[str]:
    try:
        return next(csv.reader([line], strict=True), [])
    except csv.Error as error:
        raise KeypointsError("A row can't be read as CSV.") from error
