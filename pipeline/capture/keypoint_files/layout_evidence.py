"""Evidence of people's points for a layout: lengths between points that are joints of one body.

Lengths are compared within a person, so that neither the person's distance nor the calibration's unit counts. In a
picture a length may look shorter than it is and never longer; in the world it is as it is.
"""

import itertools
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from jaxtyping import Float

from pipeline.core.data.cameras import Camera
from pipeline.core.joints import SIDES
from pipeline.core.layouts import KeypointLayout
from pipeline.geometry.camera import projection_matrices
from pipeline.geometry.epipolar import epipolar_distance_px, fundamental_matrices
from pipeline.geometry.triangulation import triangulate
from pipeline.geometry.undistortion import undistort_px

# Lengths as shares of stature: limbs as in ``skeleton.model`` (Drillis and Contini 1966), others as detectors mark
# them.
_OF_A_SIDE = {
    ("shoulder", "elbow"): 0.172,
    ("elbow", "wrist"): 0.15,
    ("shoulder", "hip"): 0.29,
    ("hip", "knee"): 0.245,
    ("knee", "ankle"): 0.246,
    ("ankle", "heel"): 0.05,
    ("ankle", "big_toe"): 0.1,
    ("heel", "big_toe"): 0.14,
    ("big_toe", "small_toe"): 0.04,
    ("eye", "ear"): 0.055,
    ("ear", "shoulder"): 0.15,
}
_TO_A_SIDE = {
    ("nose", "eye"): 0.027,
    ("nose", "ear"): 0.07,
    ("neck", "shoulder"): 0.1,
    ("neck", "hip"): 0.29,
    ("mid_hip", "hip"): 0.058,
    ("mid_hip", "shoulder"): 0.3,
}
_ACROSS = {"shoulder": 0.2, "hip": 0.115, "eye": 0.037, "ear": 0.088}
_IN_THE_MIDDLE = {
    ("neck", "mid_hip"): 0.29,
    ("nose", "neck"): 0.14,
    ("neck", "head_top"): 0.16,
    ("nose", "head_top"): 0.1,
    ("spine", "neck"): 0.145,
    ("spine", "mid_hip"): 0.145,
    ("face", "neck"): 0.08,
    ("face", "head_top"): 0.07,
}
_LENGTHS: Mapping[tuple[str, str], float] = {
    **{(f"{side}_{a}", f"{side}_{b}"): length for (a, b), length in _OF_A_SIDE.items() for side in SIDES},
    **{(a, f"{side}_{b}"): length for (a, b), length in _TO_A_SIDE.items() for side in SIDES},
    **{(f"left_{part}", f"right_{part}"): length for part, length in _ACROSS.items()},
    **_IN_THE_MIDDLE,
}
# Points of layouts that are no joints of ours and tell a layout nevertheless, by their places.
_OTHERS: Mapping[str, Mapping[int, str]] = {
    "body-25b": {17: "neck", 18: "head_top"},
    "human36m-17": {0: "mid_hip", 7: "spine", 8: "neck", 9: "face", 10: "head_top"},
}
# Limits on the logarithm of a length over the expected one, and the misfit of a pair that a layout does not name and
# another one does: a layout gains nothing by naming fewer points.
_TOO_SHORT, _TOO_LONG, _UNNAMED = 1.0, 1.5, 0.5
# Share of a person's lengths that are below the person's scale, by dimensions: pictures show most foreshortened.
_SCALE = {2: 0.75, 3: 0.5}
# Two views of a person agree within this share of the longer side of the image, by as many points.
_NEAR_SHARE, _MIN_POINTS = 0.01, 4


def misfits(
    points: Float[np.ndarray, "people points dims"], layouts: Sequence[KeypointLayout]
) -> Float[np.ndarray, "people layouts"]:
    """Mean misfit of the lengths of each person in each layout: 0 is perfect, about 0.25 usual for the right layout.

    ``points``: positions in a picture or in the world, NaN where a point was not found. Returns the misfits; NaN for
    people without two points that are a known length in any layout.
    """
    num_known = np.zeros((len(points), len(layouts)))
    total = np.zeros_like(num_known)
    for column, layout in enumerate(layouts):
        names = [_OTHERS.get(layout.name, {}).get(place, name) for place, name in enumerate(layout.points)]
        known = [pair for pair in _LENGTHS if set(pair) <= set(names)]
        first, second = ([names.index(pair[end]) for pair in known] for end in (0, 1))
        length = np.linalg.norm(points[:, first] - points[:, second], axis=-1)
        ratio = np.log(np.maximum(length, 1e-9)) - np.log([_LENGTHS[pair] for pair in known])
        is_seen = np.isfinite(ratio)
        num_known[:, column] = is_seen.sum(1)
        some = is_seen.any(1)
        scale = np.nanquantile(ratio[some], _SCALE[points.shape[-1]], axis=1, keepdims=True)
        off = np.where(is_seen[some], ratio[some] - scale, 0.0)
        total[some, column] = np.abs(np.clip(off, -_TOO_SHORT, _TOO_LONG)).sum(1)
    most = num_known.max(1, keepdims=True)
    return (total + _UNNAMED * (most - num_known)) / np.where(most > 0, most, np.nan)


def located(
    frames: Sequence[Mapping[str, Float[np.ndarray, "people points 2"]]], cameras: Sequence[Camera], max_people: int
) -> Float[np.ndarray, "people points 3"]:
    """Points in the world of people who are seen by two cameras in one frame, whatever the points are.

    ``frames``: people of each frame by camera, in pixels, NaN where a point was not found. ``cameras``: calibrated
    cameras; without them no person is located. ``max_people``: number of located people above which no further frame is
    looked at.
    """
    if not cameras:
        return np.empty((0, 0, 3))
    number_of = {camera.name: number for number, camera in enumerate(cameras)}
    fundamentals, matrices = fundamental_matrices(cameras), projection_matrices(cameras)
    people: list[np.ndarray] = []
    for frame in frames[:: 1 + len(frames) // max_people]:
        ideal_px = {
            number_of[name]: undistort_px(cameras[number_of[name]], points_px)
            for name, points_px in frame.items()
            if name in number_of
        }
        for left, right in itertools.combinations(sorted(ideal_px), 2):
            near_px = _NEAR_SHARE * max(*cameras[left].size_px, *cameras[right].size_px)
            people += (
                triangulate(matrices[[left, right]], pair_px, np.ones(pair_px.shape[:2]))
                for pair_px in _pairs(fundamentals[left, right], ideal_px[left], ideal_px[right], near_px)
            )
        if len(people) >= max_people:
            break
    return np.array(people) if people else np.empty((0, 0, 3))


def _pairs(
    fundamental: Float[np.ndarray, "3 3"],
    left_px: Float[np.ndarray, "left points 2"],
    right_px: Float[np.ndarray, "right points 2"],
    near_px: float,
) -> Iterator[Float[np.ndarray, "2 points 2"]]:
    """Views of people that are each other's best match."""
    distance_px = epipolar_distance_px(fundamental, *np.broadcast_arrays(left_px[:, None], right_px[None]))
    num_both = np.isfinite(distance_px).sum(-1)
    cost_px = np.where(num_both >= _MIN_POINTS, np.nansum(distance_px, axis=-1) / np.maximum(num_both, 1), np.inf)
    if not cost_px.size:
        return
    for row, column in enumerate(cost_px.argmin(1)):
        if cost_px[row, column] < near_px and cost_px[:, column].argmin() == row:
            yield np.stack([left_px[row], right_px[column]])
