"""Calibrations for the web API, in a child process: made from a scene, written for another program, a plan of a rig.

``python -m pipeline.calibration.on_request FILE`` reads a JSON object: the ``task`` and the arguments of its function.
It prints one JSON object, or ``{"problems": [...]}`` with exit code 2. So the web API loads no numeric libraries, and
files of strangers are read with limits of time and memory.
"""

import argparse
import base64
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from pipeline.calibration.contents import UNKNOWN_SIZE
from pipeline.calibration.known_points.scene import calibrate_scene, scene_cameras
from pipeline.calibration.program_files import PROGRAM_FORMATS, refusals
from pipeline.calibration.registry import read_contents, read_intrinsics
from pipeline.calibration.report import report_document
from pipeline.calibration.room_plan import plan_document, plan_room, plan_svg, planned_cameras
from pipeline.calibration.write import encode
from pipeline.core.data.cameras import Camera
from pipeline.core.errors import InputError, Problem
from pipeline.core.options.job_choices import KnownPoint, Up
from pipeline.core.problems.request_codes import SESSION_TOO_LARGE
from pipeline.core.problems.session_codes import INVALID_SIZE
from pipeline.core.runtime.confinement import print_answer


def make_from_scene(
    known_points: Sequence[Any], sizes_px: Mapping[str, Sequence[int]], intrinsics: str | None, up: Up
) -> dict[str, Any]:
    """Calibrate from known points, each with its name, coordinates and ``(camera, x, y)`` of its marks."""
    points = [
        KnownPoint(name, tuple(xyz_m), tuple(tuple(seen) for seen in seen_px)) for name, xyz_m, seen_px in known_points
    ]
    sizes = {camera: (width, height) for camera, (width, height) in sizes_px.items()}
    lenses = None if intrinsics is None else read_intrinsics(Path(intrinsics)).cameras
    made = calibrate_scene(scene_cameras(points, sizes, lenses), points, lenses is not None, up)
    return {
        "format": "known points",
        "units": "m",
        "axes": f"{up.upper()} up",
        "warnings": [],
        "text": encode(made.cameras).decode(),
        "report": report_document(made),
    }


def write_for_program(calibration: str, to: str) -> dict[str, Any]:
    """Write a stored calibration in a format of ``PROGRAM_FORMATS``."""
    cameras = _sized(calibration)
    if problems := refusals(to, cameras, ""):
        raise InputError(problems)
    return {"content": base64.b64encode(PROGRAM_FORMATS[to].encode(cameras)).decode()}


def plan_rig(
    room_m: tuple[float, float],
    cameras: int,
    height_m: float,
    field_deg: float,
    size_px: tuple[int, int],
    people: int,
    calibration: str | None,
) -> dict[str, Any]:
    """Plan a rig of new cameras, or of the cameras of a stored calibration."""
    rig = planned_cameras(room_m, cameras, height_m, size_px, field_deg) if calibration is None else _sized(calibration)
    plan = plan_room(rig, room_m, people)
    return plan_document(plan) | {"picture": plan_svg(plan, rig, room_m)}


def _sized(calibration: str) -> tuple[Camera, ...]:
    """Cameras of a stored calibration, all with sizes of their pictures."""
    cameras = read_contents(Path(calibration)).cameras
    message, hint = (
        "The calibration does not contain the size of the picture.",
        "Add it to the file, and send it again.",
    )
    unsized = [camera.name for camera in cameras if camera.size_px == UNKNOWN_SIZE]
    if unsized:
        raise InputError([Problem(INVALID_SIZE, message, None, name, "size", hint) for name in unsized])
    return cameras


_TASKS: Mapping[str, Callable[..., dict[str, Any]]] = {
    "scene": make_from_scene,
    "file": write_for_program,
    "plan": plan_rig,
}


def main(words: Sequence[str] | None = None) -> int:
    """Do the task of a file; return the exit code."""
    parser = argparse.ArgumentParser(description="Work on a calibration.")
    parser.add_argument("file", type=Path)
    request = json.loads(parser.parse_args(words).file.read_bytes())
    too_large = Problem(SESSION_TOO_LARGE, "The calibration needs more memory than the service allows.")
    return print_answer(lambda: _TASKS[request.pop("task")](**request), too_large)


if __name__ == "__main__":
    sys.exit(main())
