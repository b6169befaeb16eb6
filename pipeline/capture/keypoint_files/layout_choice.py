"""Layout of points that files do not name: chosen, told by the number of points, or told by the people.

Several layouts have 17, 18 or 25 points. Which one a session has is told by its people: by the lengths between their
points in the pictures, and if those do not tell it, by the lengths of people who are located by two cameras.
"""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import Literal

import numpy as np
from jaxtyping import Float

from pipeline.capture.keypoint_files.people import People, is_detected
from pipeline.capture.keypoint_files.points import CANDIDATES, arranged
from pipeline.capture.preflight_record import LayoutRead
from pipeline.core.data.cameras import Camera
from pipeline.core.errors import Problem
from pipeline.core.findings import Finding
from pipeline.core.joints import SIDES
from pipeline.core.layouts import KeypointLayout
from pipeline.core.problems.finding_codes import KEYPOINTS_FORM
from pipeline.core.problems.session_codes import KEYPOINTS_LAYOUT
from pipeline.geometry.camera import projection_matrices
from pipeline.geometry.epipolar import epipolar_distance_px, fundamental_matrices
from pipeline.geometry.triangulation import triangulate
from pipeline.geometry.undistortion import undistort_px

# Evidence of people's points for a layout: lengths between points that are joints of one body. Lengths are compared
# within a person, so that neither the person's distance nor the calibration's unit counts. In a picture a length may
# look shorter than it is and never longer; in the world it is as it is.

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
        # The quantile of the known lengths: unknown ones are sorted to the end.
        ordered, place = np.sort(ratio[some], axis=1), _SCALE[points.shape[-1]] * (num_known[some, column] - 1)
        below, above = (np.take_along_axis(ordered, f(place)[:, None].astype(int), 1) for f in (np.floor, np.ceil))
        off = np.where(is_seen[some], ratio[some] - below - (place % 1)[:, None] * (above - below), 0.0)
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


Frames = Mapping[str, Mapping[int, People]]
"""People of each frame by camera and number of the frame; their points are in the order of the files."""

# People whose lengths are looked at, spread over all frames, and those that two cameras locate.
_MAX_PEOPLE, _MAX_LOCATED = 4000, 400
# Least score of a point that is looked at, as a share of the mean score of the person.
_MIN_SCORE_SHARE = 0.3
# Limits on the difference of the mean misfits of two layouts: for any number of people, for a single person, and in
# standard errors. For a person in a picture the misfits differ by 0.3 to 0.5 as a rule, and less than 0 is rare.
_MIN_LEAD, _MIN_LEAD_OF_ONE, _NUM_ERRORS = 0.05, 0.25, 2.5
# Largest mean misfit of the right layout: 0.3 is usual in pictures, and random points have 0.6 and more.
_MAX_MISFIT = 0.5


def tell_layout(
    frames: Frames,
    num_points: int,
    cameras: Sequence[Camera],
    chosen: KeypointLayout | None,
    findings: list[Finding],
    problems: list[Problem],
) -> LayoutRead | None:
    """Tell the layout of people with so many points; ``None`` and a problem if several layouts remain.

    The stated layout, ``chosen``, is taken if it has so many points; else that is the problem.

    ``cameras`` are calibrated cameras; empty if their poses are unknown.
    """
    candidates = CANDIDATES[num_points]
    names = " or ".join(layout.name for layout in candidates)
    if chosen is not None and chosen not in candidates:
        message = (
            f"The layout {chosen.name} was stated, which has {len(chosen.points)} points; people have {num_points}."
        )
        problems.append(Problem(KEYPOINTS_LAYOUT, message, field="layout", hint=f"State {names}, or no layout."))
        return None
    if len(candidates) == 1:
        return LayoutRead(candidates[0].name, "number" if chosen is None else "choice")
    told = _told(_sampled(frames, num_points), candidates, cameras)
    if chosen is not None:
        if told is not None and told.told_by != "points" and told.name != chosen.name:
            message = f"The layout {chosen.name} was stated, but the lengths of the people fit {told.name} better."
            hint = f"Check the joints in the result; if they are wrong, state {told.name} or no layout."
            evidence = {"layout": chosen.name, "fits": told.name}
            findings.append(Finding(KEYPOINTS_FORM, message, hint=hint, evidence=evidence))
        return LayoutRead(chosen.name, "choice")
    if told is None:
        message = f"People have {num_points} points, and their lengths do not tell which layout it is: {names}."
        hint = f"State the layout, {names}: --layout at the command line, layout in the manifest or on the page."
        problems.append(Problem(KEYPOINTS_LAYOUT, message, field="layout", hint=hint))
    elif told.name != candidates[0].name:
        findings.append(Finding(KEYPOINTS_FORM, str(told), severity="info", evidence={"layout": told.name}))
    return told


def rearranged(people: People, layout: KeypointLayout) -> People:
    """Joints of a layout in place of the points in the order of a file; hands behind the points stay."""
    num_points = len(layout.points)
    if people.shape[1] < num_points or layout == CANDIDATES[num_points][0]:
        return people
    return np.concatenate([arranged(people[:, :num_points], layout), people[:, num_points:]], axis=1)


_Sample = Sequence[Mapping[str, Float[np.ndarray, "people points 2"]]]


def _sampled(frames: Frames, num_points: int) -> _Sample:
    """Points of people by camera in some of the frames, NaN where they were not detected, or hardly."""
    numbers = sorted({number for by_frame in frames.values() for number, people in by_frame.items() if people.size})
    num_people = sum(len(people) for by_frame in frames.values() for people in by_frame.values())
    every = 1 + num_people // _MAX_PEOPLE
    return [
        {
            camera: _seen(by_frame[number][:, :num_points])
            for camera, by_frame in frames.items()
            if number in by_frame and by_frame[number].shape[1] >= num_points and len(by_frame[number])
        }
        for number in numbers[::every]
    ]


def _seen(people: People) -> Float[np.ndarray, "people points 2"]:
    is_seen = is_detected(people)
    # Wrong points have low scores, whatever the scale of the detector's scores.
    score = np.where(is_seen, people[..., 2], 0.0)
    mean = score.sum(1, keepdims=True) / np.maximum(is_seen.sum(1, keepdims=True), 1)
    return np.where((is_seen & (score >= _MIN_SCORE_SHARE * mean))[..., None], people[..., :2], np.nan)


def _told(sample: _Sample, candidates: Sequence[KeypointLayout], cameras: Sequence[Camera]) -> LayoutRead | None:
    """Layout that the people tell; ``None`` if several remain."""
    people = [points for frame in sample for points in frame.values()]
    points = np.concatenate([np.empty((0, len(candidates[0].points), 2)), *people])
    is_seen = np.isfinite(points).all(-1).any(0)
    if all(len({layout.points[place] for layout in candidates}) == 1 for place in np.flatnonzero(is_seen)):
        return LayoutRead(candidates[0].name, "points")
    return _best(points, candidates, "pictures") or _best(located(sample, cameras, _MAX_LOCATED), candidates, "world")


def _best(
    points: Float[np.ndarray, "people points dims"],
    candidates: Sequence[KeypointLayout],
    told_by: Literal["pictures", "world"],
) -> LayoutRead | None:
    """Layout that fits the people clearly better than all others; ``None`` without one."""
    if not len(points):
        return None
    misfit = misfits(points, candidates)
    misfit = misfit[np.isfinite(misfit).all(1)]
    if not len(misfit):
        return None
    best = int(misfit.mean(0).argmin())
    lead = np.delete(misfit, best, axis=1) - misfit[:, [best]]
    least = np.maximum(_MIN_LEAD, np.maximum(_NUM_ERRORS * lead.std(0), _MIN_LEAD_OF_ONE) / np.sqrt(len(lead)))
    if misfit[:, best].mean() > _MAX_MISFIT or (lead.mean(0) < least).any():
        return None
    return LayoutRead(candidates[best].name, told_by, len(misfit))
