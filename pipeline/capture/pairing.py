"""Pair cameras with videos, or with folders of keypoints."""

from collections.abc import Collection, Sequence
from typing import Literal, NamedTuple

from pipeline.data.cameras import Camera
from pipeline.errors import Problem
from pipeline.findings import Finding
from pipeline.problem_codes.findings import CAMERA_LEFT_OUT, PAIRED_IN_SORTED_ORDER
from pipeline.problem_codes.model import Code
from pipeline.problem_codes.sessions import (
    CAMERA_WITH_TWO_FOLDERS,
    CAMERA_WITH_TWO_VIDEOS,
    CAMERA_WITHOUT_FOLDER,
    CAMERA_WITHOUT_VIDEO,
    FOLDER_WITHOUT_CAMERA,
    VIDEO_WITHOUT_CAMERA,
)

MIN_CAMERAS = 2


class _Codes(NamedTuple):
    """Codes of an input without a camera, of a second input of a camera, and of a camera without input."""

    without_camera: Code
    second: Code
    missing: Code


_CODES = {
    "video": _Codes(VIDEO_WITHOUT_CAMERA, CAMERA_WITH_TWO_VIDEOS, CAMERA_WITHOUT_VIDEO),
    "folder": _Codes(FOLDER_WITHOUT_CAMERA, CAMERA_WITH_TWO_FOLDERS, CAMERA_WITHOUT_FOLDER),
}
# Names that a warning lists.
_MAX_SHOWN = 12


def pair_by_name(
    cameras: Sequence[Camera], names: Sequence[str], thing: Literal["video", "folder"], required: Collection[str] = ()
) -> tuple[dict[str, str], list[Problem], list[Finding]]:
    """Pair cameras and inputs, either all by exact name or all in sorted order.

    Parameters
    ----------
    cameras
        Cameras. An input may have the name of a camera, or of the camera's section in the calibration.
    names
        Names of the inputs without endings.
    thing
        Kind of input, such as ``video``.
    required
        Names of cameras that must have an input, because the manifest names them.

    Returns
    -------
    pairs
        Name of the input of each camera, by camera name.
    problems
        Inputs without camera, second inputs of a camera, and required cameras without input; all cameras without
        input, if there is another problem, or if fewer than two cameras have one.
    findings
        List of the pairs, if they were paired in sorted order; list of the cameras that are left out.
    """
    codes = _CODES[thing]
    known = {camera.section: camera.name for camera in cameras} | {camera.name: camera.name for camera in cameras}
    called = [camera.name for camera in cameras]
    if not known.keys() & set(names) and len(called) == len(names):
        pairs = dict(zip(sorted(called), sorted(names), strict=True))
        shown = ", ".join(f"{camera}: {name}" for camera, name in pairs.items())
        return pairs, [], [_sorted(thing, shown)]
    pairs = {}
    problems: list[Problem] = []
    for name in sorted(set(names)):
        camera = known.get(name)
        if camera is None:
            problems.append(
                Problem(
                    codes.without_camera,
                    f"The calibration has no camera with the name of this {thing}.",
                    file=name,
                    hint=f"The calibration's cameras are {', '.join(sorted(called))}.",
                )
            )
        elif camera in pairs:
            problems.append(
                Problem(
                    codes.second,
                    f"This {thing} and {pairs[camera]} belong to the same camera.",
                    file=name,
                    camera=camera,
                    hint="Remove one of them.",
                )
            )
        else:
            pairs[camera] = name
    missing = sorted(set(called) - pairs.keys())
    is_subset = not problems and len(pairs) >= MIN_CAMERAS
    refused = [camera for camera in missing if not is_subset or camera in required]
    problems = [
        Problem(
            codes.missing,
            f"The calibration has this camera, but no {thing} has its name.",
            camera=camera,
            hint=f"Add its {thing}, or remove it from the calibration.",
        )
        for camera in refused
    ] + problems
    left_out = [camera for camera in missing if camera not in refused]
    return pairs, problems, [_left_out(left_out, thing)] if left_out else []


def _sorted(thing: str, pairs: str) -> Finding:
    message = f"No {thing} has the name of a camera. They were paired in sorted order: {pairs}."
    hint = f"Check the pairs; give each {thing} the name of its camera."
    return Finding(PAIRED_IN_SORTED_ORDER, message, hint=hint)


def _left_out(cameras: Sequence[str], thing: str) -> Finding:
    shown = ", ".join(cameras[:_MAX_SHOWN]) + (", ..." if len(cameras) > _MAX_SHOWN else "")
    message = f"{len(cameras)} cameras of the calibration have no {thing}: {shown}. They are left out."
    if len(cameras) == 1:
        message = f"The camera {shown} of the calibration has no {thing}: it is left out."
    hint = f"If a {thing} is missing, add it."
    return Finding(
        CAMERA_LEFT_OUT,
        message,
        cameras[0] if len(cameras) == 1 else None,
        "info",
        hint,
        {"num_cameras": len(cameras)},
    )
