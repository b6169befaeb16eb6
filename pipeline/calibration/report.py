"""Calibrations that were made from a board or from people, and their reports."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import isfinite
from typing import Any

from pipeline.data import Camera
from pipeline.errors import Problem, listed


@dataclass(frozen=True, slots=True)
class CameraReport:
    """Evidence for the calibration of a camera.

    Parameters
    ----------
    name
        Name of the camera.
    reprojection_error_px
        Median distance of the projections from the observations; NaN without observations.
    focal_px
        Focal length: mean of both axes.
    num_views
        Number of instants at which the camera saw the board, or a person.
    focal_sigma_percent, position_sigma_mm, rotation_sigma_deg
        Standard deviations that the observations leave; infinite where they don't determine the parameter, NaN where it
        was given.
    """

    name: str
    reprojection_error_px: float
    focal_px: float
    num_views: int
    focal_sigma_percent: float
    position_sigma_mm: float
    rotation_sigma_deg: float


@dataclass(frozen=True, slots=True, eq=False)
class MadeCalibration:
    """A calibration and its report.

    Parameters
    ----------
    cameras
        Calibrated cameras; world in metres, Z up.
    has_extrinsics
        Whether the cameras' poses are known; else only intrinsics were made and every pose is the identity.
    by_camera
        Reports, in the order of the cameras.
    reprojection_error_px
        Median over all cameras.
    warnings
        Doubts, each with a code, the camera and a hint: what to film again.
    world
        Sentence: origin, axes and scale of the world, and what they rest on.
    pictures
        SVG documents by file name, such as ``coverage_cam_1.svg``.
    """

    cameras: tuple[Camera, ...]
    has_extrinsics: bool
    by_camera: tuple[CameraReport, ...]
    reprojection_error_px: float
    warnings: tuple[Problem, ...]
    world: str
    pictures: Mapping[str, str] = field(default_factory=dict)


def report_document(made: MadeCalibration) -> dict[str, Any]:
    """Report of a calibration as JSON: numbers that are not finite are ``None``."""
    return {
        "schema_version": 1,
        "cameras": [
            {
                "name": camera.name,
                "reprojection_error_px": _number(camera.reprojection_error_px),
                "focal_px": _number(camera.focal_px),
                "num_views": camera.num_views,
                "focal_sigma_percent": _number(camera.focal_sigma_percent),
                "position_sigma_mm": _number(camera.position_sigma_mm),
                "rotation_sigma_deg": _number(camera.rotation_sigma_deg),
            }
            for camera in made.by_camera
        ],
        "reprojection_error_px": _number(made.reprojection_error_px),
        "has_extrinsics": made.has_extrinsics,
        "world": made.world,
        "warnings": [
            {"code": one.code, "message": one.message, "camera": one.camera, "hint": one.hint}
            for one in listed(made.warnings)
        ],
    }


def _number(value: float) -> float | None:
    return round(value, 4) if isfinite(value) else None
