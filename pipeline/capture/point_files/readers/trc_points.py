"""Reader of TRC files: OpenSim's, Pose2Sim's and ours, as Cortex writes them; Y up unless people stand otherwise.

Cells are separated by tabs; public files also have commas, or spaces.
"""

from io import StringIO
from pathlib import Path

import numpy as np

from pipeline.capture.keypoint_files.people import KeypointsError
from pipeline.capture.point_files.point_reader import PointTable, point_reader

_NUM_HEADS = 5


@point_reader("TRC", ".trc")
def read_trc(path: Path) -> PointTable:
    """Read a file: five lines of headers, then frame, time and x, y, z of each marker; an empty cell is unknown."""
    lines = path.read_text("utf-8-sig").splitlines()
    if len(lines) <= _NUM_HEADS or not lines[0].startswith("PathFileType"):
        raise KeypointsError("The file has no header of TRC, which begins with PathFileType.")
    mark = next((mark for mark in "\t," if mark in lines[3]), None)
    # Public files have a different number of tabs in the two lines of facts.
    facts = dict(zip(*(line.replace(",", " ").split() for line in lines[1:3]), strict=False))
    names = tuple(name.strip() for name in lines[3].split(mark)[2:] if name.strip())
    width = 2 + 3 * len(names)
    rows = (line.split(mark) for line in lines[_NUM_HEADS:] if line.strip())
    cells = "\n".join("\t".join((cells + [""] * width)[:width]) for cells in rows)
    values = np.genfromtxt(StringIO(cells), delimiter="\t", ndmin=2)
    return PointTable(
        names,
        values[:, 2:].reshape(len(values), -1, 3),
        float(facts["DataRate"]),
        facts["Units"].lower(),
        "y",
        float(values[0, 1]),
    )
