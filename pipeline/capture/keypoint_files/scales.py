"""Scales of the numbers of keypoint files, which the files do not state: told by all values of a camera.

Scores are confidences from 0 to 1, percent, 0 to 255, or logits. Networks without a last sigmoid or softmax, such as
RTMW and Keypoint R-CNN, write scores of up to 10 or 20 on no known scale; heatmaps reach 1.4. Positions are
pixels or shares of the picture, for example by OpenPose's ``--keypoint_scale`` 3 (0 to 1) and 4 (-1 to 1).
"""

from collections.abc import Iterator, Mapping

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import expit

from pipeline.calibration.contents import UNKNOWN_SIZE
from pipeline.capture.keypoint_files.people import People, is_detected
from pipeline.core.errors import Problem
from pipeline.core.findings import Finding
from pipeline.core.parsing import KEYPOINT_PX
from pipeline.core.problems.finding_codes import KEYPOINTS_SCALE
from pipeline.core.problems.session_codes import KEYPOINTS_SCORES
from pipeline.core.runtime import large_arrays

_Frames = dict[int, People]

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
# Share of the positions outside of the picture from which on they are doubtful.
_MAX_OUTSIDE = 0.2
# Share of width or height that positions reach below which they are doubtful: of one camera, and of all.
_MIN_FILLED, _MIN_FILLED_ALL = 0.25, 0.5
# Share of negative coordinates from which on shares count from the middle of the picture: fewer are of joints outside.
_MAX_NEGATIVE_SHARE = 0.1


def rescaled(
    frames: Mapping[str, _Frames],
    folders: Mapping[str, str],
    sizes_px: Mapping[str, tuple[int, int]],
    findings: list[Finding],
    problems: list[Problem],
) -> dict[str, _Frames]:
    """People of the cameras' folders with scores from 0 to 1 and positions in pixels; findings state what was assumed.

    Scores of an unknown scale are a problem.

    ``frames``: people by folder and number of the frame. ``folders``: folder of each camera. ``sizes_px``: width and
    height of each camera's pictures.
    """
    scored = {
        camera: _with_confidences(camera, frames[folder], findings, problems)
        for camera, folder in folders.items()
        if sizes_px[camera] != UNKNOWN_SIZE
    }
    positions = {camera: _positions(by_frame) for camera, by_frame in scored.items()}
    highest = {
        camera: np.percentile(np.abs(xy), _HIGH, method="nearest") for camera, xy in positions.items() if len(xy)
    }
    shares = {camera: positions[camera] for camera, high in highest.items() if high <= _MAX_SHARE}
    findings += _misplaced({camera: positions[camera] for camera in highest.keys() - shares.keys()}, sizes_px)
    # All cameras count alike: one of them may see people in a single quarter of its picture.
    low = -1 if any((xy < 0).mean() > _MAX_NEGATIVE_SHARE for xy in shares.values()) else 0
    for camera in shares:
        scale_px = (np.array(sizes_px[camera]) - 1.0) / (1 - low)
        scored[camera] = {
            number: np.concatenate(
                [(np.clip(people[..., :2], -_MAX_SHARE, _MAX_SHARE) - low) * scale_px, people[..., 2:]], axis=-1
            )
            for number, people in scored[camera].items()
        }
        message = (
            f"{camera}: positions are read as shares of the picture, from {low} to 1: they were converted to pixels."
        )
        hint = "If they are something else, write pixels."
        findings.append(Finding(KEYPOINTS_SCALE, message, camera, hint=hint, evidence={"low": low, "high": 1}))
    return {folders[camera]: by_frame for camera, by_frame in scored.items()}


def _misplaced(
    positions: Mapping[str, Float[np.ndarray, "_ 2"]], sizes_px: Mapping[str, tuple[int, int]]
) -> Iterator[Finding]:
    """Report cameras whose positions are often outside of the picture, or fill a corner of it.

    Of a single camera a small corner is doubtful, as it is with percent; of all cameras a larger one, as with smaller
    pictures.
    """
    reaches_px = {camera: np.percentile(xy, _HIGH, axis=0, method="nearest") for camera, xy in positions.items()}
    filled = {camera: (reach_px / sizes_px[camera]).max() for camera, reach_px in reaches_px.items()}
    least = _MIN_FILLED_ALL if max(filled.values(), default=0.0) < _MIN_FILLED_ALL else _MIN_FILLED
    for camera, reach_px in sorted(reaches_px.items()):
        size_px = sizes_px[camera]
        outside = float(((positions[camera] < 0) | (positions[camera] > size_px)).any(-1).mean())
        if outside <= _MAX_OUTSIDE and filled[camera] >= least:
            continue
        x_px, y_px = np.round(reach_px).astype(int).tolist()
        message = (
            f"{camera}: positions reach x {x_px} and y {y_px} in a picture of {size_px[0]} x {size_px[1]} pixels. "
            "They may be in another unit or of pictures of another size."
        )
        hint = "Write pixels of pictures of the size in the calibration, x first."
        evidence = {"x_px": x_px, "y_px": y_px, "outside": round(outside, 3)}
        yield Finding(KEYPOINTS_SCALE, message, camera, hint=hint, evidence=evidence)


def _with_confidences(camera: str, frames: _Frames, findings: list[Finding], problems: list[Problem]) -> _Frames:
    """People with scores from 0 to 1, as far as their scale is known."""
    points = _points(frames)
    scores = points[_is_scored(points), 2]
    scores = scores[scores != _NOT_FOUND]
    if not len(scores):
        return frames
    low, high = np.percentile(scores, [_LOW, _HIGH], method="nearest")
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
    return large_arrays.concatenate([np.empty((0, 3)), *(people.reshape(-1, 3) for people in frames.values())])


def _positions(frames: _Frames) -> Float[np.ndarray, "_ 2"]:
    """Positions of all joints that were found."""
    points = _points(frames)
    return large_arrays.copy(points[is_detected(points) & points[:, :2].any(-1), :2])


def _is_scored(points: Float[np.ndarray, "*points 3"]) -> Bool[np.ndarray, "*points"]:
    """True where points have positions and scores; zeros mean that a joint was not found."""
    within = np.isfinite(points).all(-1) & (np.abs(points[..., :2]) <= KEYPOINT_PX.high).all(-1)
    return within & points[..., :2].any(-1) & (points[..., 2] != 0)


def _scored(people: People, scores: Float[np.ndarray, "_ _"]) -> People:
    return np.concatenate([people[..., :2], scores[..., None]], axis=-1)
