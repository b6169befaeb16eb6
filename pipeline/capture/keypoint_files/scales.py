"""Scales of the numbers of keypoint files, which the files do not state: told by all values of a camera.

Scores are confidences from 0 to 1, percent, 0 to 255, or logits. Networks without a last sigmoid or softmax, such as
RTMW and Keypoint R-CNN, write scores of up to 10 or 20 whose scale nobody knows; heatmaps reach 1.4. Positions are
pixels or shares of the picture, as of OpenPose's ``--keypoint_scale`` 3 (0 to 1) and 4 (-1 to 1).
"""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import expit

from pipeline.capture.keypoint_files.people import People, is_detected
from pipeline.errors import Problem
from pipeline.findings import Finding
from pipeline.parsing import KEYPOINT_PX
from pipeline.problem_codes.findings import KEYPOINTS_SCALE
from pipeline.problem_codes.sessions import KEYPOINTS_SCORES

_Frames = Mapping[int, People]

# Percentiles that tell the scale: a few values beyond it are outliers.
_HIGH, _LOW = 99.0, 1.0
# Highest scores (percentile) of each scale: a heatmap with noise, a network of unknown scale, percent, 8 bits.
_MAX_CONFIDENCE, _MAX_UNKNOWN, _MAX_PERCENT, _MAX_8_BIT = 1.5, 40.0, 101.0, 256.0
# Logits below this are wrong joints; negative noise of heatmaps is above it.
_MAX_NEGATIVE = -0.5
# EasyMocap's score of a joint that was not found, and COCO's visibilities.
_NOT_FOUND, _VISIBILITIES = -1.0, {1.0, 2.0}
# Shares of joints outside of the picture may exceed 1. A person within 3 pixels is none.
_MAX_SHARE = 3.0
# Share of coordinates left of or above the picture from which on shares count from its middle.
_MIN_NEGATIVE = 0.02


def rescaled(
    frames: Mapping[str, _Frames],
    sizes_px: Mapping[str, tuple[int, int]],
    findings: list[Finding],
    problems: list[Problem],
) -> dict[str, _Frames]:
    """People of each camera with scores from 0 to 1 and positions in pixels; findings state what was assumed.

    ``sizes_px`` has width and height of each camera's pictures. Scores of an unknown scale are a problem.
    """
    scored = {camera: _with_confidences(camera, by_frame, findings, problems) for camera, by_frame in frames.items()}
    shares = {}
    for camera, by_frame in scored.items():
        points = _points(by_frame)
        positions = points[is_detected(points), :2]
        if len(positions) and np.abs(positions).max() <= _MAX_SHARE:
            shares[camera] = positions
    # All cameras count alike: one of them may see people in a single quarter of its picture.
    low = -1 if any((positions < -_MIN_NEGATIVE).mean() > _MIN_NEGATIVE for positions in shares.values()) else 0
    for camera in shares:
        scale_px = (np.array(sizes_px[camera]) - 1.0) / (1 - low)
        scored[camera] = {
            number: np.concatenate([(people[..., :2] - low) * scale_px, people[..., 2:]], axis=-1)
            for number, people in scored[camera].items()
        }
        message = (
            f"{camera}: positions are read as shares of the picture, from {low} to 1: they were converted to pixels."
        )
        hint = "If they are something else, write pixels."
        findings.append(Finding(KEYPOINTS_SCALE, message, camera, hint=hint, evidence={"low": low, "high": 1}))
    return scored


def _with_confidences(camera: str, frames: _Frames, findings: list[Finding], problems: list[Problem]) -> _Frames:
    """People with scores from 0 to 1, as far as their scale is known."""
    points = _points(frames)
    scores = points[_is_scored(points), 2]
    scores = scores[scores != _NOT_FOUND]
    if not len(scores):
        return frames
    low, high = np.percentile(scores, [_LOW, _HIGH])
    evidence = {"low": float(low), "high": float(high)}
    hint = "If they are something else, write scores from 0 to 1."
    if low < _MAX_NEGATIVE and 1.0 < high <= _MAX_UNKNOWN:
        message = f"{camera}: scores from {low:.3g} to {high:.3g} are read as logits: 0 is a confidence of a half."
        findings.append(Finding(KEYPOINTS_SCALE, message, camera, hint=hint, evidence=evidence))
        return {
            number: _scored(people, np.where(_is_scored(people), expit(people[..., 2]), 0.0))
            for number, people in frames.items()
        }
    if low < _MAX_NEGATIVE or high > _MAX_8_BIT:
        message = f"Scores are from {low:.3g} to {high:.3g}, a scale that is not known."
        hint = "Write scores from 0 to 1, percent, 0 to 255, or logits."
        problems.append(Problem(KEYPOINTS_SCORES, message, camera=camera, field="score", hint=hint))
        return frames
    if high <= _MAX_CONFIDENCE or set(np.unique(scores)) <= _VISIBILITIES:
        return frames
    if high <= _MAX_UNKNOWN:
        message = f"{camera}: scores are up to {high:.3g}, a scale that is not known: scores above 1 count as 1."
        hint = "Write scores from 0 to 1, so that doubtful joints count less."
        findings.append(Finding(KEYPOINTS_SCALE, message, camera, "info", hint, evidence))
        return frames
    scale, divisor = ("percent", 100) if high <= _MAX_PERCENT else ("0 to 255", 255)
    message = f"{camera}: scores of up to {high:.3g} are read as {scale}: they were divided by {divisor}."
    findings.append(Finding(KEYPOINTS_SCALE, message, camera, hint=hint, evidence=evidence))
    return {number: _scored(people, people[..., 2] / divisor) for number, people in frames.items()}


def _points(frames: _Frames) -> Float[np.ndarray, "points 3"]:
    """All points of a camera."""
    return np.concatenate([np.empty((0, 3)), *(people.reshape(-1, 3) for people in frames.values())])


def _is_scored(points: Float[np.ndarray, "*points 3"]) -> Bool[np.ndarray, "*points"]:
    """Whether points have positions and scores; zeros mean that a joint was not found."""
    within = np.isfinite(points).all(-1) & (np.abs(points[..., :2]) <= KEYPOINT_PX.high).all(-1)
    return within & points[..., :2].any(-1) & (points[..., 2] != 0)


def _scored(people: People, scores: Float[np.ndarray, "_ _"]) -> People:
    return np.concatenate([people[..., :2], scores[..., None]], axis=-1)
