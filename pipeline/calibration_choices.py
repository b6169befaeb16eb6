"""Choices of a calibration that is to be made. Standard library only: web API, job store and stages read them."""

from dataclasses import dataclass

BOARD_FRAMES = 600
"""Largest number of frames of a camera in which a board is looked for."""

MIN_STATURE_M, MAX_STATURE_M = 0.5, 2.6
"""Limits of the stature of a person who calibrates cameras."""
MAX_STATURES = 20
"""Largest number of people whose statures are given."""

MAX_KNOWN_POINTS, MAX_POINT_M = 200, 10_000.0
"""Largest number of points with known coordinates, and largest coordinate."""


@dataclass(frozen=True, slots=True)
class KnownPoint:
    """Point whose coordinates in the world are known.

    Parameters
    ----------
    name
        Name of the point.
    xyz_m
        Coordinates in the world.
    seen_px
        Cameras that see it, each with the distorted pixel at which it is seen: ``(camera, x, y)``.
    """

    name: str
    xyz_m: tuple[float, float, float]
    seen_px: tuple[tuple[str, float, float], ...]


@dataclass(frozen=True, slots=True)
class CalibrationChoices:
    """Choices of a calibration from a board, or from people.

    Parameters
    ----------
    board
        Specification of the board, as of ``pipeline.calibration.board.spec``; ``None``: people calibrate.
    has_intrinsics
        Whether the session's cameras have known intrinsics, which stay; else they are guessed, and made.
    stature_m
        Statures of the people, in any order; none with a board.
    known_points
        Points that determine the world; without any, the board or the people do.
    has_photographs
        Whether the footage is photographs of a board, which have no times.
    """

    board: str | None
    has_intrinsics: bool = False
    stature_m: tuple[float, ...] = ()
    known_points: tuple[KnownPoint, ...] = ()
    has_photographs: bool = False

    @property
    def method(self) -> str:
        """From what the calibration is made."""
        return "people" if self.board is None else "board"
