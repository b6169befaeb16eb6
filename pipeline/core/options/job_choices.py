"""Calibrations as requests state them, and other products of jobs: proxies, visuals. Standard library only."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

Units = Literal["m", "cm", "mm", "in", "cmu"]
"""Units of length; ``cmu`` is the unit of the CMU database's skeletons, an inch by 0.45."""
Up = Literal["x", "-x", "y", "-y", "z", "-z"]
"""Axis of a file's world that points up."""

UNITS_M: Mapping[Units, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "cmu": 0.0254 / 0.45}

BOARD_FORM = "chessboard:COLSxROWS:SQUARE_M or charuco:COLSxROWS:SQUARE_M:MARKER_M:DICTIONARY"
"""Specification of a board."""

BOARD_FRAMES = 600
"""Largest number of frames of a camera in which a board is looked for."""

MIN_STATURE_M, MAX_STATURE_M = 0.5, 2.6
"""Limits of the stature of a person who calibrates cameras."""
MAX_STATURES = 20
"""Largest number of people whose statures are given."""

POINT_COLUMNS = ("name", "x_m", "y_m", "z_m", "camera", "x_px", "y_px")
MAX_KNOWN_POINTS, MAX_POINT_M = 200, 10_000.0
"""Columns of the table of points with known coordinates; their largest number, and largest coordinate."""

PROXY_KIND = "proxy"
"""Kind of the result files that are proxies."""

BLURRED_KIND = "blurred"
"""Kind of the result files that are copies of a session's videos with blurred heads. Edits of people leave them."""

OVERLAY_KIND, REPORT_KIND, RERUN_KIND = "overlay", "report", "rerun"
VISUAL_KINDS = frozenset({OVERLAY_KIND, REPORT_KIND, RERUN_KIND})
"""Kinds of the result files that are made to be looked at, and take minutes."""


@dataclass(frozen=True, slots=True)
class KnownPoint:
    """Point whose coordinates in the world are known."""

    name: str  # Name of the point
    xyz_m: tuple[float, float, float]  # Coordinates in the world
    # Cameras that see it, each with the distorted pixel at which it is seen: ``(camera, x, y)``
    seen_px: tuple[tuple[str, float, float], ...]


@dataclass(frozen=True, slots=True)
class CalibrationChoices:
    """Choices of a calibration from a board, or from people."""

    # Specification of the board, see ``pipeline.calibration.board.spec``; ``None``: people calibrate
    board: str | None
    # True if the session's cameras have known intrinsics, which stay; else they are guessed, and made
    has_intrinsics: bool = False
    stature_m: tuple[float, ...] = ()  # Statures of the people, in any order; none with a board
    # Points that determine the world; without any, the board or the people do
    known_points: tuple[KnownPoint, ...] = ()
    has_photographs: bool = False  # True if the footage is photographs of a board, which have no times

    @property
    def method(self) -> str:
        """From what the calibration is made."""
        return "people" if self.board is None else "board"


@dataclass(frozen=True, slots=True)
class ProxyChoices:
    """Cameras whose videos get a proxy: a small copy that browsers play."""

    cameras: tuple[str, ...]


def proxy_name(number: int) -> str:
    """Name of the result file with the proxy of the camera that has a number in its session, from 0."""
    return f"proxy-{number}.mp4"


def blurred_name(number: int) -> str:
    """Name of the result file with the blurred video of the camera that has a number in its session, from 0."""
    return f"blurred-{number}.mp4"


@dataclass(frozen=True, slots=True)
class VisualChoices:
    """Overlay videos and the report are made of a reconstruction that is done, as far as its choices ask for them.

    ``blurs_videos``: copies of its videos with blurred heads are made too.
    """

    blurs_videos: bool = False
