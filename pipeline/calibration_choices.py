"""Choices of a calibration that is to be made. Standard library only: web API, job store and stages read them."""

from dataclasses import dataclass

BOARD_FRAMES = 600
"""Largest number of frames of a camera in which a board is looked for."""


@dataclass(frozen=True, slots=True)
class CalibrationChoices:
    """Choices of a calibration from a board.

    Parameters
    ----------
    board
        Specification of the board, as of ``pipeline.calibration.board.spec``.
    has_intrinsics
        Whether the session's cameras have known intrinsics, which stay; else they are guessed, and made.
    """

    board: str
    has_intrinsics: bool = False
