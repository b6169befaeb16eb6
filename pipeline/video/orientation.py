"""How stored pictures are mirrored and turned for display."""

import math
import struct
from fractions import Fraction
from typing import Any, NamedTuple

from av.filter import Graph
from av.sidedata.sidedata import Type
from av.video.frame import VideoFrame

from pipeline.core.errors import Problem
from pipeline.core.problems.finding_codes import SHOWN_MIRRORED

# FFmpeg's kinds of side data that PyAV does not know, such as EXIF data: it gives no side data of a frame with one.
_UNKNOWN_KINDS = sorted(set(range(48)) - {kind.value for kind in Type})


class Orientation(NamedTuple):
    """How a stored picture is turned for display."""

    rotation_deg: int  # Counterclockwise turn, after the mirroring: 0, 90, 180 or 270
    is_mirrored: bool  # True if left and right of the stored picture are exchanged before the turn


def display_orientation(frame: VideoFrame) -> Orientation:
    """Orientation nearest to the display matrix of a frame, from its container or its EXIF data."""
    try:
        side_data = frame.side_data
    except ValueError:
        side_data = _without_unknown_kinds(frame).side_data
    matrix: Any = side_data.get("DISPLAYMATRIX")
    if matrix is None:
        return Orientation(0, False)
    # The pixel (x, y) is shown at (a x + c y, b x + d y), but for a shift.
    a, b, _, c, d, *_ = struct.unpack("=9i", bytes(matrix))
    is_mirrored = a * d < b * c
    if is_mirrored:
        a, b = -a, -b
    return Orientation(round(math.atan2(c - b, a + d) / (math.pi / 2)) % 4 * 90, is_mirrored)


def _without_unknown_kinds(frame: VideoFrame) -> VideoFrame:
    graph = Graph()
    nodes = [graph.add_buffer(width=frame.width, height=frame.height, format=frame.format, time_base=Fraction(1))]
    nodes += [graph.add("sidedata", f"mode=delete:type={kind}") for kind in _UNKNOWN_KINDS]
    graph.link_nodes(*nodes, graph.add("buffersink")).configure()
    graph.vpush(frame)
    return graph.vpull()


def mirrored() -> Problem:
    """Build the warning of a video or of images that are shown mirrored."""
    return Problem(
        SHOWN_MIRRORED,
        "The file says that its picture is mirrored for display. It is read mirrored, like players show it.",
        hint="If the calibration is of the picture that is not mirrored, turn off the mirroring and export again.",
    )
