"""Layout of points that files do not name: chosen, told by the number of points, or told by the people.

Several layouts have 17, 18 or 25 points. Which one a session has is told by its people: by the lengths between their
points in the pictures, and if those do not tell it, by the lengths of people who are located by two cameras.
"""

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
from jaxtyping import Float

from pipeline.capture.keypoint_files.layout_evidence import located, misfits
from pipeline.capture.keypoint_files.people import People, is_detected
from pipeline.capture.keypoint_files.points import CANDIDATES, arranged
from pipeline.capture.preflight_record import LayoutRead
from pipeline.core.data.cameras import Camera
from pipeline.core.errors import Problem
from pipeline.core.findings import Finding
from pipeline.core.layouts import KeypointLayout
from pipeline.core.problems.finding_codes import KEYPOINTS_FORM
from pipeline.core.problems.session_codes import KEYPOINTS_LAYOUT

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
