"""Calibrations that were made from a board or from people, and their reports."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite, nan
from typing import Any

import numpy as np
from jaxtyping import Float

from pipeline.calibration.adjustment.parameters import FOCAL, POSITION, ROTATION
from pipeline.core.data.cameras import Camera
from pipeline.core.errors import Problem, listed
from pipeline.core.findings import from_problem


@dataclass(frozen=True, slots=True)
class PointReport:
    """Known point in the picture of a camera."""

    name: str
    error_px: float  # Distance of its projection from its mark
    projected_px: Sequence[float]  # Projection x, y


@dataclass(frozen=True, slots=True)
class CameraReport:
    """Evidence for the calibration of a camera."""

    name: str  # Name of the camera
    reprojection_error_px: float  # Median distance of the projections from the observations; NaN without observations
    focal_px: float  # Focal length: mean of both axes
    num_views: int  # Number of instants at which the camera saw the board, or a person
    # Standard deviations that the observations leave; infinite where they don't determine the parameter, NaN where it
    # was given
    focal_sigma_percent: float
    position_sigma_mm: float
    rotation_sigma_deg: float
    points: Sequence[PointReport] = ()  # Of a calibration from a scene


def report_camera(
    camera: Camera, error_px: float, num_views: int, sigma: Float[np.ndarray, " 22"], growth: float = 1.0
) -> CameraReport:
    """Report a camera of an adjustment.

    ``sigma`` has the standard deviations of its parameters (``adjustment.parameters``), 0 where they were given;
    ``growth`` is the factor by which the world grew after the adjustment.
    """
    return CameraReport(
        camera.name,
        float(error_px),
        float(camera.matrix.diagonal()[:2].mean()),
        num_views,
        float(100 * sigma[FOCAL][0]) or nan,
        float(1000 * growth * np.linalg.norm(sigma[POSITION])),
        float(np.degrees(np.linalg.norm(sigma[ROTATION]))),
    )


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationResult:
    """A calibration and its report."""

    cameras: tuple[Camera, ...]  # Calibrated cameras; world in metres, Z up
    # The cameras' poses are known; else only intrinsics were made and every pose is the identity
    has_extrinsics: bool
    by_camera: tuple[CameraReport, ...]  # Reports, in the order of the cameras
    reprojection_error_px: float  # Median over all cameras
    warnings: tuple[Problem, ...]  # Doubts, each with a code, the camera and a hint: what to film again
    world: str  # Sentence: origin, axes and scale of the world, and what they rest on
    # SVG documents by file name, such as ``coverage_cam_1.svg``
    pictures: Mapping[str, str] = field(default_factory=dict)


def report_document(calibration: CalibrationResult) -> dict[str, Any]:
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
                **({"points": list(map(_point, camera.points))} if camera.points else {}),
            }
            for camera in calibration.by_camera
        ],
        "reprojection_error_px": _number(calibration.reprojection_error_px),
        "has_extrinsics": calibration.has_extrinsics,
        "world": calibration.world,
        "warnings": [from_problem(warning, "warning").to_json() for warning in listed(calibration.warnings)],
    }


def _point(point: PointReport) -> dict[str, Any]:
    projected_px = [round(value, 2) for value in point.projected_px]
    return {"name": point.name, "error_px": round(point.error_px, 2), "projected_px": projected_px}


def _number(value: float) -> float | None:
    return round(value, 4) if isfinite(value) else None
