"""Reader of YOLO's pose labels: a text file a frame, a line a person.

A line has the class, the box (x, y, width, height), and x, y and score of each point; then perhaps the score of the box
and the number of a track. Lines of COCO's 17 points may lack the scores. Positions are shares of the image. Ultralytics
divides pixels by the size of the image, and writes points with low scores at (0, 0). Format:
https://docs.ultralytics.com/datasets/pose, ``Results.save_txt``

Rows of the table of formats:

| YOLO (Ultralytics) | a frame: the labels of poses, `save_txt=True`: `class x y w h`, then `x y score` of each point |
COCO-17, Halpe-26 and -136, COCO-WholeBody | positions are shares of the picture in the calibration; a frame without
people has no file: it counts as dropped |
"""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pipeline.capture.keypoint_files.keypoint_reader import reader
from pipeline.capture.keypoint_files.people import KeypointsError, People, check_number, is_detected, no_people
from pipeline.capture.keypoint_files.points import CANDIDATES, KeypointReading
from pipeline.core.joints import COCO_17
from pipeline.core.parsing import UnreadableError

_NUM_LEADING = 5
# Numbers of points of the data sets that networks of YOLO are trained with.
_NUMS_POINTS = (17, 23, 26, 133, 136)
# Beyond the image by as much as a network could mean; pixels are far larger.
_MIN_SHARE, _MAX_SHARE = -2.0, 3.0


class _Line(NamedTuple):
    """Form of the lines of a file."""

    num_points: int
    has_scores: bool


def _lines() -> dict[int, _Line]:
    """Forms of lines by the number of their numbers, of which each belongs to one form."""
    forms = {}
    for count in _NUMS_POINTS:
        for num_more in range(3):
            forms[_NUM_LEADING + 3 * count + num_more] = _Line(count, has_scores=True)
            if count == len(COCO_17.names):
                forms[_NUM_LEADING + 2 * count + num_more] = _Line(count, has_scores=False)
    return forms


LINES: Mapping[int, _Line] = _lines()
"""Forms of lines by the number of their numbers."""


def is_labels(beginning: bytes) -> bool:
    """True if a text file begins with a line of labels: the class, the box, and more numbers if there are points."""
    words = beginning.split(b"\n", 1)[0].split()
    try:
        return len(words) >= _NUM_LEADING and all(np.isfinite(float(word)) for word in words[:_NUM_LEADING])
    except ValueError:
        return False


def load_labels(path: Path) -> str:
    """Labels of a file; raises ``UnreadableError`` if the content is no text."""
    try:
        return path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise UnreadableError from error


@reader("YOLO", suffixes=(".txt",), load=load_labels)
def read_frame(content: str, reading: KeypointReading) -> People:
    """Read the people of a frame with at least one detected joint.

    Raises ``KeypointsError`` or ``CrowdError`` if the lines can't be used.
    """
    rows = [line.split() for line in content.splitlines() if not line.isspace() and line]
    check_number(rows)
    if not rows:
        return no_people()
    if reading.size_px is None:
        raise KeypointsError("Labels are shares of an image whose size the calibration must state.")
    counts = sorted({len(row) for row in rows})
    if len(counts) > 1:
        raise KeypointsError(f"Lines have different numbers of numbers: {', '.join(map(str, counts[:3]))}.")
    if len({row[0] for row in rows}) > 1:
        raise KeypointsError("Lines are of several classes; keep the lines of people.", "class")
    form = _line_form(counts[0])
    num_points, num_values = form.num_points, 3 if form.has_scores else 2
    try:
        values = np.array([[float(word) for word in row] for row in rows])
    except ValueError:
        raise KeypointsError("A line has words that are not numbers.") from None
    shares = values[:, _NUM_LEADING : _NUM_LEADING + num_values * num_points].reshape(len(rows), num_points, num_values)
    people = np.ones((len(rows), num_points, 3))
    people[..., :num_values] = shares
    # Ultralytics keeps the score of a point that it moves to (0, 0).
    people[(people[..., :2] == 0).all(-1), 2] = 0.0
    found = people[is_detected(people), :2]
    if ((found < _MIN_SHARE) | (found > _MAX_SHARE)).any():
        raise KeypointsError("Positions must be shares of the image, from 0 to 1.")
    people[..., :2] *= reading.size_px
    return reading.people(people, reading.layout(num_points, "points"))


def _line_form(count: int) -> _Line:
    """Form of lines with so many numbers; raises ``KeypointsError`` if there is none."""
    if count in LINES:
        return LINES[count]
    if _NUM_LEADING <= count <= _NUM_LEADING + 2:
        raise KeypointsError("The labels are boxes without points: detect with a model of poses, such as yolo11n-pose.")
    known = ", ".join(f"{_NUM_LEADING + 3 * count} ({CANDIDATES[count][0].name})" for count in _NUMS_POINTS)
    raise KeypointsError(f"A line has {count} numbers; with a class, a box and points it has {known}.")
