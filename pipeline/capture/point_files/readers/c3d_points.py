"""Reader of C3D files by ezc3d: points, and poses of segments in the group ROTATION, as Theia and we write them."""

from pathlib import Path
from typing import Any

import numpy as np

from pipeline.capture.keypoint_files.people import KeypointsError
from pipeline.capture.point_files.point_reader import PointTable, point_reader


@point_reader("C3D", ".c3d")
def read_c3d(path: Path) -> PointTable:
    """Read a file; a point is unknown where its residual is negative. The origin of a segment is its proximal joint."""
    try:
        import ezc3d  # noqa: PLC0415 - optional
    except ModuleNotFoundError:
        message = "C3D files need the package ezc3d, which is not installed: pip install multicap[c3d]."
        raise KeypointsError(message) from None
    file: Any = ezc3d.c3d(str(path))
    points, facts, data = file["parameters"]["POINT"], file["header"]["points"], file["data"]
    xyz = data["points"][:3].transpose(2, 1, 0)
    xyz[(data["meta_points"]["residuals"][0].T < 0) | (xyz == 0).all(-1)] = np.nan
    names = [label for key in sorted(points) if key.startswith("LABELS") for label in points[key]["value"]]
    rate_hz = float(facts["frame_rate"])
    rotations = data.get("rotations", np.zeros((4, 4, 0, 0)))
    turns: dict[str, np.ndarray] = {}
    if rotations.size:
        origins = rotations[:3, 3].transpose(2, 1, 0)
        labels = file["parameters"]["ROTATION"]["LABELS"]["value"]
        ratio = max(1, len(origins) // max(1, len(xyz)))
        turns = dict(zip(labels, rotations[:3, :3, :, ::ratio].transpose(2, 3, 0, 1), strict=False))
        xyz = np.concatenate([xyz, origins[::ratio]], axis=1) if len(xyz) else origins
        names = [*names[: xyz.shape[1] - len(labels)], *labels]
    unit = next(iter(points.get("UNITS", {}).get("value", [])), "mm").strip().lower()
    start_s = facts["first_frame"] / rate_hz
    return PointTable(tuple(names[: xyz.shape[1]]), xyz, rate_hz, unit, "z", start_s, turns)
