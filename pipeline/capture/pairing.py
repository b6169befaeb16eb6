"""Pair cameras with videos, or with folders of keypoints."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Literal, NamedTuple

from pipeline.capture.names import cameras_in_names, natural_key
from pipeline.core.data.cameras import Camera
from pipeline.core.errors import Problem
from pipeline.core.findings import Finding
from pipeline.core.problems import session_codes
from pipeline.core.problems.code_group import Code
from pipeline.core.problems.finding_codes import CAMERA_LEFT_OUT, PAIRED_IN_SORTED_ORDER

MIN_CAMERAS = 2

Thing = Literal["video", "folder"]
"""Kind of input of a camera."""


class _Codes(NamedTuple):
    """Codes of an input without a camera, of a second input of a camera, and of a camera without input."""

    without_camera: Code
    second: Code
    missing: Code


_CODES = {
    "video": _Codes(
        session_codes.VIDEO_WITHOUT_CAMERA, session_codes.CAMERA_WITH_TWO_VIDEOS, session_codes.CAMERA_WITHOUT_VIDEO
    ),
    "folder": _Codes(
        session_codes.FOLDER_WITHOUT_CAMERA, session_codes.CAMERA_WITH_TWO_FOLDERS, session_codes.CAMERA_WITHOUT_FOLDER
    ),
}
# Names that a message lists.
_MAX_SHOWN = 12


class Pairing(NamedTuple):
    """Inputs of cameras."""

    pairs: Mapping[str, str]  # Name of the input of each camera, by camera name
    # Inputs without camera or of several cameras, second inputs of a camera, and required cameras without input; all
    # cameras without input, if there is another problem, or if fewer than two cameras have one
    problems: Sequence[Problem]
    # List of the pairs, if they were paired by order; list of the cameras that are left out
    findings: Sequence[Finding]


def pair(
    cameras: Sequence[Camera],
    names: Sequence[str],
    thing: Thing,
    stated: Mapping[str, str] | None = None,
    required: Collection[str] = (),
    by_order: bool = False,
) -> Pairing:
    """Pair cameras and inputs: as stated, and the others by name, or by order if that is asked for.

    - ``cameras``: cameras. The name of an input has the name of a camera, or of the camera's section in the
      calibration, as a whole word; see ``cameras_in_names``.
    - ``names``: names of the inputs without endings, but for those that are stated.
    - ``stated``: names of inputs by the names of their cameras, whatever their names say.
    - ``required``: names of cameras that must have an input, because the manifest names them.
    - ``by_order``: pair inputs and cameras by the natural order of their names, whatever the names are.
    """
    stated = stated or {}
    free = _sorted({*names})
    if by_order:
        paired, problems = _by_order([camera.name for camera in cameras if camera.name not in stated], free, thing)
    else:
        paired, problems = _by_name(cameras, free, stated, thing)
    pairs = {**stated, **paired}
    findings = [_in_order(thing, paired)] if by_order and paired and not problems else []
    if any(problem.code in {session_codes.PAIRING_COUNTS, session_codes.PAIRING_UNKNOWN} for problem in problems):
        return Pairing(pairs, problems, findings)
    missing = _sorted(camera.name for camera in cameras if camera.name not in pairs)
    is_subset = not problems and len(pairs) >= MIN_CAMERAS
    refused = [camera for camera in missing if not is_subset or camera in required]
    problems = [
        Problem(
            _CODES[thing].missing,
            f"The calibration has this camera, but no {thing} has its name.",
            camera=camera,
            hint=f"Add its {thing}, or remove it from the calibration.",
        )
        for camera in refused
    ] + problems
    left_out = [camera for camera in missing if camera not in refused]
    return Pairing(pairs, problems, [*findings, *([_left_out(left_out, thing)] if left_out else [])])


def _by_order(cameras: Sequence[str], names: Sequence[str], thing: Thing) -> tuple[dict[str, str], list[Problem]]:
    """Pair cameras and inputs by the natural order of their names."""
    if len(cameras) == len(names):
        return dict(zip(_sorted(cameras), names, strict=True)), []
    message = f"{len(names)} {thing}s can't be paired by order with {len(cameras)} cameras."
    return {}, [Problem(session_codes.PAIRING_COUNTS, message, hint=_lists(cameras, names, thing))]


def _by_name(
    cameras: Sequence[Camera], names: Sequence[str], stated: Mapping[str, str], thing: Thing
) -> tuple[dict[str, str], list[Problem]]:
    """Pair cameras and inputs by name; report inputs of no camera, of several, and of a camera that has one."""
    codes = _CODES[thing]
    called = [camera.name for camera in cameras]
    or_state = f", or state the {thing} of each camera"
    found = cameras_in_names(names, {camera.name: [camera.section] for camera in cameras})
    if names and not stated and not any(found.values()):
        message = f"No {thing} has the name of a camera."
        hint = (
            f"{_lists(called, names, thing)} Name them alike{or_state}, or pair them by order: --pair-by-order, or "
            "pair_by_order in the manifest."
        )
        return {}, [Problem(session_codes.PAIRING_UNKNOWN, message, hint=hint)]
    pairs: dict[str, str] = {}
    problems = []
    for name, of_name in found.items():
        if not of_name:
            message = f"The calibration has no camera with the name of this {thing}."
            hint = _lists(called, names, thing)
            problems.append(Problem(codes.without_camera, message, file=name, hint=hint))
        elif len(of_name) > 1:
            message = f"The name of this {thing} fits several cameras: {', '.join(of_name)}."
            hint = f"{_lists(called, names, thing)} Rename the {thing}{or_state}."
            problems.append(Problem(session_codes.PAIRING_AMBIGUOUS, message, file=name, hint=hint))
        elif (other := stated.get(of_name[0])) is not None:
            message = f"This {thing} has the name of the camera {of_name[0]}, but {other} is assigned to it."
            hint = f"Assign this {thing} to its camera, or omit it."
            problems.append(Problem(codes.second, message, file=name, camera=of_name[0], hint=hint))
        elif (other := pairs.get(of_name[0])) is not None:
            message = f"This {thing} and {other} have the name of the same camera."
            hint = f"Remove one of them{or_state}."
            problems.append(Problem(codes.second, message, file=name, camera=of_name[0], hint=hint))
        else:
            pairs[of_name[0]] = name
    return pairs, problems


def _lists(cameras: Iterable[str], names: Iterable[str], thing: Thing) -> str:
    return f"The cameras are {_shown(_sorted(cameras))}; the {thing}s are {_shown(_sorted(names))}."


def _shown(names: Sequence[str]) -> str:
    return ", ".join(names[:_MAX_SHOWN]) + (", ..." if len(names) > _MAX_SHOWN else "")


def _sorted(names: Iterable[str]) -> list[str]:
    return sorted(names, key=natural_key)


def _in_order(thing: Thing, pairs: Mapping[str, str]) -> Finding:
    shown = ", ".join(f"{camera}: {name}" for camera, name in pairs.items())
    message = f"Cameras and {thing}s are paired by the order of their names: {shown}."
    return Finding(PAIRED_IN_SORTED_ORDER, message, hint=f"Check the pairs; give each {thing} the name of its camera.")


def _left_out(cameras: Sequence[str], thing: Thing) -> Finding:
    message = f"{len(cameras)} cameras of the calibration have no {thing}: {_shown(cameras)}. They are left out."
    if len(cameras) == 1:
        message = f"The camera {cameras[0]} of the calibration has no {thing}: it is left out."
    hint = f"If a {thing} is missing, add it."
    return Finding(
        CAMERA_LEFT_OUT,
        message,
        cameras[0] if len(cameras) == 1 else None,
        "info",
        hint,
        {"num_cameras": len(cameras)},
    )
