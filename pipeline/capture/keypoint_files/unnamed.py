"""Points that files do not name: the known layouts of as many points."""

from collections.abc import Mapping

from pipeline.capture.keypoint_files.people import KeypointsError
from pipeline.core.layouts import FILE_LAYOUTS, KeypointLayout

CANDIDATES: Mapping[int, tuple[KeypointLayout, ...]] = {
    count: tuple(layout for layout in FILE_LAYOUTS.values() if len(layout.points) == count)
    for count in sorted({len(layout.points) for layout in FILE_LAYOUTS.values()})
}
"""Layouts by number of points, the usual one first: of several it has all joints in the order of its points."""


class UnnamedPoints:
    """Layouts of the points of a folder's files that do not name them.

    ``counts`` are the numbers of points of a person in the files that were read.
    """

    def __init__(self) -> None:
        self.counts: set[int] = set()

    def layout(self, num_points: int, field: str) -> KeypointLayout:
        """Layout in which so many points are kept until ``layout_choice`` tells theirs: the first of ``CANDIDATES``.

        Raises ``KeypointsError`` if there is none.
        """
        if num_points not in CANDIDATES:
            known = ", ".join(FILE_LAYOUTS)
            raise KeypointsError(f"A person has {num_points} points; layouts that are read are {known}.", field)
        self.counts.add(num_points)
        return CANDIDATES[num_points][0]
