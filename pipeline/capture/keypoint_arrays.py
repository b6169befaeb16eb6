"""Session of 2D joints from arrays in memory, checked like files."""

import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pipeline.calibration.registry import read_calibration
from pipeline.calibration.validate import MAX_CAMERAS, RawCamera, build_camera
from pipeline.capture.keypoint_files.own_points import with_own
from pipeline.capture.keypoint_files.people import CrowdError, KeypointsError, People
from pipeline.capture.keypoint_files.points import KeypointReading
from pipeline.capture.keypoint_files.scales import rescaled
from pipeline.capture.keypoints import KeypointSession, session_of_frames
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera, FrameTimes
from pipeline.core.data.rigid import Rigid3
from pipeline.core.errors import InputError, Problem
from pipeline.core.findings import Finding
from pipeline.core.layouts import FILE_LAYOUTS
from pipeline.core.options.arguments import checked, wrong_values
from pipeline.core.options.config import MAX_OUTPUT_FRAMES
from pipeline.core.options.rules import unlisted_value
from pipeline.core.parsing import TIME_S
from pipeline.core.paths import StrPath
from pipeline.core.problems import session_codes
from pipeline.core.problems.finding_codes import CAMERA_LEFT_OUT
from pipeline.core.problems.request_codes import INVALID_VALUE

_DIMENSIONS = ("time", "individuals", "keypoints", "space")  # of the package ``movement``, in our order
_SHAPES = "must be numbers of the shape (frames, people, joints, 2), or (frames, joints, 2) of one person"


@checked
def from_arrays(
    keypoints_px: Mapping[str, Any] | Sequence[Any] | np.ndarray,
    scores: Mapping[str, Any] | Sequence[Any] | np.ndarray | None,
    cameras: Sequence[Camera] | StrPath,
    frame_rate_hz: float | None = None,
    times_s: Mapping[str, Any] | Sequence[float] | np.ndarray | None = None,
    joints: Sequence[str] | np.ndarray | str | None = None,
) -> KeypointSession:
    """Make a session from 2D joints that another program detected.

    - ``keypoints_px``: distorted pixels (frames, people, joints, 2) by the camera's name or in the cameras' order; NaN
      where a joint was not detected. Rows of people are in any order. Arrays of xarray are read by the names of their
      dimensions: (time, individuals, keypoints, space) in any order, all cameras along ``view``.
    - ``scores``: confidences in [0, 1], without the last axis; ``None``: 1 for each finite joint.
    - ``cameras``: calibrated cameras, or the path of a calibration.
    - ``frame_rate_hz``, ``times_s``: rate of all cameras, or seconds of each frame on a common clock, by the camera's
      name if they differ.
    - ``joints``: names of the points, or a layout such as ``halpe-26``; ``None``: the number of points tells it.
    - Raises ``InputError``: with all problems of all arguments.
    """
    problems: list[Problem] = []
    findings: list[Finding] = []
    checked = _checked_cameras(cameras, problems)
    names = [camera.name for camera in checked]
    if isinstance(joints, str):
        problems += unlisted_value("joints", joints, FILE_LAYOUTS)
    if (frame_rate_hz is None) == (times_s is None):
        message = "State frame_rate_hz, or times_s, and not both."
        problems.append(Problem(session_codes.TWO_CLOCKS, message, field="frame_rate_hz"))
    if problems:
        raise InputError(problems)
    of_cameras = _by_camera(keypoints_px, names, "keypoints_px", problems)
    of_scores = {} if scores is None else _by_camera(scores, names, "scores", problems)
    of_times = _by_camera(times_s, names, "times_s", problems) if isinstance(times_s, Mapping) else None
    if left_out := [name for name in names if name not in of_cameras]:
        message = f"keypoints_px has no array of {', '.join(left_out[:8])}, {len(left_out)} cameras: they are left out."
        findings.append(Finding(CAMERA_LEFT_OUT, message, severity="info", evidence={"num_cameras": len(left_out)}))
    people: dict[str, dict[int, People]] = {}
    own: dict[str, tuple[str, ...]] = {}
    counts: dict[str, frozenset[int]] = {}
    times: dict[str, FrameTimes] = {}
    layout_name = joints if isinstance(joints, str) else None
    named = None if joints is None or layout_name else tuple(map(str, np.asarray(joints).tolist()))
    for camera in checked:
        name = camera.name
        of_points = None if scores is None else of_scores.get(name, ())
        points = _points(of_cameras[name], of_points, name, problems) if name in of_cameras else None
        if points is None:
            continue
        if named is not None and len(named) != points.shape[2]:
            problems.append(_wrong("joints", f"has {len(named)} names; keypoints_px has {points.shape[2]} points"))
            break
        reading = KeypointReading(camera.size_px)
        if (read := _people(points, named, reading, name, problems)) is not None:
            people[name], own[name] = read
            counts[name] = frozenset(reading.counts)
            if times_s is not None:
                shared = times_s if of_times is None else of_times.get(name)
                times[name] = _times(shared, len(points), name, problems)
    if problems:
        raise InputError(problems)
    sizes_px = {camera.name: camera.size_px for camera in checked}
    people |= rescaled(people, {name: name for name in people}, sizes_px, findings, problems)
    rate_hz = None if frame_rate_hz is None else float(frame_rate_hz)
    return session_of_frames(checked, people, counts, layout_name, rate_hz, times, findings, problems, own)


def _people(
    points: np.ndarray, named: Sequence[str] | None, reading: KeypointReading, camera: str, problems: list[Problem]
) -> tuple[dict[int, People], tuple[str, ...]] | None:
    """People of each frame, with points of the user's own behind their joints, and the names of these points."""
    try:
        layout = reading.layout(points.shape[2] if named is None else named, "joints")
        read = [(reading.people(frame, layout), reading.take_own()) for frame in points]
    except KeypointsError as error:
        problems.append(Problem(INVALID_VALUE, str(error), camera=camera, field=error.field or "keypoints_px"))
    except CrowdError as error:
        problems.append(_wrong("keypoints_px", f"has a frame with {error}, more than allowed", camera))
    else:
        of_people, of_own = (dict(enumerate(part)) for part in zip(*read, strict=True))
        return with_own(of_people, of_own)
    return None


def _wrong(field: str, message: str, camera: str | None = None) -> Problem:
    return Problem(INVALID_VALUE, f"{field} {message}.", camera=camera, field=field)


def _checked_cameras(cameras: Sequence[Camera] | StrPath, problems: list[Problem]) -> tuple[Camera, ...]:
    if isinstance(cameras, str | os.PathLike):
        return read_calibration(cameras)
    if not 0 < len(cameras) <= MAX_CAMERAS or len({camera.name for camera in cameras}) < len(cameras):
        problems.append(_wrong("cameras", f"must be 1 to {MAX_CAMERAS} cameras, whose names differ"))
        return ()
    built: list[Camera] = []
    for place, camera in enumerate(cameras):
        pose = camera.cam_from_world
        if wrong := tuple(wrong_values({"cam_from_world": Rigid3}, {"cam_from_world": pose})):
            problems += wrong
            continue
        raw = RawCamera(
            *(camera.name, camera.size_px, camera.matrix, camera.distortion, pose.rotation, pose.translation_m),
            lens=camera.lens,
        )
        found = build_camera(raw, place, "cameras")
        if isinstance(found, Camera):
            built.append(found)
        else:
            problems += found
    return tuple(built)


def _by_camera(arrays: Any, names: Sequence[str], field: str, problems: list[Problem]) -> Mapping[str, Any]:
    """Arrays by the camera's name: a mapping as it is, else the entries in the cameras' order."""
    if isinstance(arrays, Mapping):
        if unknown := [str(name) for name in arrays if name not in names]:
            problems.append(_wrong(field, f"has arrays of unknown cameras: {', '.join(unknown[:8])}"))
        return arrays
    if "view" in _dimensions(arrays):
        views = list(arrays.transpose("view", ...))
        if "view" in arrays.coords:
            return _by_camera(dict(zip(map(str, arrays["view"].values), views, strict=True)), names, field, problems)
        arrays = views
    if not hasattr(arrays, "__len__") or len(arrays) != len(names):
        problems.append(_wrong(field, f"must have an array for each of the {len(names)} cameras"))
        return {}
    return dict(zip(names, arrays, strict=True))


def _points(keypoints_px: Any, scores: Any, camera: str, problems: list[Problem]) -> np.ndarray | None:
    """People of each frame, their points, and x, y and score; without scores every finite point is certain."""
    points, score = floats(keypoints_px), None if scores is None else floats(scores)
    if points is not None and points.ndim == 3:
        points, score = points[:, None], None if score is None else score[:, None]
    if points is None or points.ndim != 4 or points.shape[-1] != 2 or not 0 < len(points) <= MAX_OUTPUT_FRAMES:
        problems.append(_wrong("keypoints_px", _SHAPES, camera))
        return None
    if scores is not None and (score is None or score.shape != points.shape[:-1]):
        problems.append(_wrong("scores", "must be numbers of the shape of keypoints_px without its last axis", camera))
        return None
    known = np.isfinite(points).all(-1)
    return np.concatenate([points, (known * 1.0 if score is None else score)[..., None]], axis=-1)


def _dimensions(values: Any) -> tuple[str, ...]:
    """Names of the dimensions of an array of xarray; none of other arrays."""
    names = getattr(values, "dims", ())
    return names if isinstance(names, tuple) else ()


def floats(values: Any) -> np.ndarray | None:
    """Numbers, NaN where they are masked; ``None`` if they are none, or instants."""
    if (named := _dimensions(values)) and {*named} <= {*_DIMENSIONS}:
        values = values.transpose(*(name for name in _DIMENSIONS if name in named))
    try:
        numbers = np.ma.asanyarray(values)
        return None if numbers.dtype.kind in "cmM" else numbers.astype(np.float64).filled(np.nan)
    except (TypeError, ValueError, OverflowError):
        return None


def _times(values: Any, num_frames: int, camera: str, problems: list[Problem]) -> FrameTimes:
    time_s = floats(values)
    if time_s is None or time_s.shape != (num_frames,) or not TIME_S.holds(time_s) or (np.diff(time_s) <= 0).any():
        problems.append(_wrong("times_s", f"must be {num_frames} ascending times, {TIME_S}", camera))
        return FrameTimes(np.zeros(num_frames))
    return FrameTimes(read_only(time_s.copy()))
