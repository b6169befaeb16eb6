"""Choices of a calibration that is to be made. Standard library only: web API, job store and stages read them."""

from dataclasses import dataclass
from typing import Literal

BOARD_FRAMES = 600
"""Largest number of frames of a camera in which a board is looked for."""


@dataclass(frozen=True, slots=True)
class CalibrationChoices:
    """Choices of a calibration from a board or from people.

    Parameters
    ----------
    method
        What the cameras filmed.
    board
        Specification of the board, as of ``pipeline.calibration.board.spec``; for the method ``board``.
    stature_m
        Stature of the tallest person; for the method ``people``.
    has_intrinsics
        Whether the session's cameras have known intrinsics, which stay; else they are guessed, and made.
    """

    method: Literal["board", "people"]
    board: str | None = None
    stature_m: float | None = None
    has_intrinsics: bool = False
