"""Points in the order of a file, as joints in the order of a joint set."""

from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np

from pipeline.capture.keypoint_files.names import named_layout
from pipeline.capture.keypoint_files.people import KeypointsError, People
from pipeline.joints import without_hands
from pipeline.layouts import LAYOUTS, Layout

_NAMES = ("coco-17", "coco-wholebody-23", "halpe-26", "coco-wholebody-133", "halpe-136")
_BY_COUNT: Mapping[int, Layout] = {len(LAYOUTS[name].points): LAYOUTS[name] for name in _NAMES}
# Layouts with hands: points of fingers have names of each file's own, so that the number tells the layout.
_WHOLE = {133, 136}


def layout_of(num_points: int, field: str) -> Layout:
    """Layout of so many points without names; raises ``KeypointsError`` if there is none."""
    if num_points not in _BY_COUNT:
        known = ", ".join(f"{layout.name.rpartition('-')[0]} has {count}" for count, layout in _BY_COUNT.items())
        raise KeypointsError(f"A person has {num_points} points; {known}.", field)
    return _BY_COUNT[num_points]


def layout_of_names(names: Sequence[str], field: str) -> Layout:
    """Layout of points with names; raises ``KeypointsError`` if they are not those of a body."""
    return _BY_COUNT[len(names)] if len(names) in _WHOLE else named_layout(names, field)


def arranged(points: People, layout: Layout) -> People:
    """Points of people as the joints of their layout; joints without a point, and hands of nobody, are not detected.

    Parameters
    ----------
    points
        People, points of the layout, and x, y and score.

    Returns
    -------
        People, joints of ``layout.joints`` (without fingers if nobody has a finger), and x, y and score.
    """
    joints, taken = _chosen(layout)
    people = np.zeros((len(points), len(layout.joints.names), 3))
    people[:, joints] = points[:, taken]
    num_body = len(without_hands(layout.joints).names)
    return people if people[:, num_body:].any() else people[:, :num_body]


@lru_cache(maxsize=64)
def _chosen(layout: Layout) -> tuple[list[int], list[int]]:
    """Joints that have a point, and their points."""
    joints = [k for k, name in enumerate(layout.joints.names) if name in layout.points]
    return joints, [layout.points.index(layout.joints.names[k]) for k in joints]
