"""OpenPose's BODY_25B: as many points as BODY_25 has, in another order, and files do not say which one they have.

In BODY_25 the neck and the middle of the hips are points of their own, between shoulders and hips. Read in that order,
points of BODY_25B are far from there; read in its own, its neck is above the middle of the shoulders.
"""

from collections.abc import Iterable, Iterator

import numpy as np
from jaxtyping import Float

from pipeline.capture.keypoint_files.people import People, is_detected
from pipeline.capture.keypoint_files.points import arranged
from pipeline.layouts import LAYOUTS

_LAYOUT = LAYOUTS["body-25b"]
_NUM_POINTS = len(_LAYOUT.points)
# Points of the two orders: neck, its neighbours left and right, and as many of the hips; the trunk is between both.
_NECK, _SHOULDERS, _MID_HIP, _HIPS = 1, [2, 5], 8, [9, 12]
_NECK_B, _SHOULDERS_B, _HIPS_B = 17, [5, 6], [11, 12]
# Distances as shares of the trunk. Necks and hips of BODY_25 are within a tenth of it, those of the wrong order half.
_FAR, _NEAR = 0.35, 0.35
# People of whom the points are looked at, and the fewest.
_MOST, _FEWEST = 2000, 5


def is_body_25b(people: Iterable[People]) -> bool:
    """Return whether people of 25 points are in the order of BODY_25B, not of BODY_25; by the median of many."""
    off = list(_off(people))
    if len(off) < _FEWEST:
        return False
    as_body_25, as_body_25b = np.median(off, axis=0)
    return bool(as_body_25 > _FAR and as_body_25b < _NEAR)


def _off(people: Iterable[People]) -> Iterator[tuple[float, float]]:
    """Distance of the neck (and hips) from where they are in each order, as shares of the trunk, of each person."""
    num_left = _MOST
    for of_frame in people:
        if not num_left:
            return
        if of_frame.shape[1] != _NUM_POINTS:
            continue
        seen = is_detected(of_frame)
        needed = [_NECK, *_SHOULDERS, _MID_HIP, *_HIPS, _NECK_B, *_SHOULDERS_B, *_HIPS_B]
        for points in of_frame[seen[:, needed].all(1), :, :2][:num_left]:
            num_left -= 1
            trunk_px = max(_apart(points[_SHOULDERS_B].mean(0), points[_HIPS_B].mean(0)), 1e-6)
            own_px = max(_apart(points[_NECK], points[_MID_HIP]), 1e-6)
            neck, hips = points[_SHOULDERS].mean(0), points[_HIPS].mean(0)
            yield (
                max(_apart(points[_NECK], neck), _apart(points[_MID_HIP], hips)) / own_px,
                _apart(points[_NECK_B], points[_SHOULDERS_B].mean(0)) / trunk_px,
            )


def _apart(first: Float[np.ndarray, " 2"], second: Float[np.ndarray, " 2"]) -> float:
    return float(np.linalg.norm(first - second))


def from_body_25b(people: People) -> People:
    """Joints of people in the order of BODY_25B; frames without people stay."""
    return arranged(people, _LAYOUT) if people.shape[1] == _NUM_POINTS else people
