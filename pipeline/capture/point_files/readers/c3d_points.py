"""Reader of C3D files: points, and poses of segments in the group ROTATION, as Theia and we write them."""

from pathlib import Path

import numpy as np

from pipeline.capture.keypoint_files.people import KeypointsError
from pipeline.capture.laboratory.c3d_content import C3dError, read_content
from pipeline.capture.point_files.point_reader import PointTable, point_reader
from pipeline.core.data.laboratory import continued


@point_reader("C3D", ".c3d")
def read_c3d(path: Path) -> PointTable:
    """Read a file. The origin of a segment is its proximal joint."""
    try:
        content = read_content(path.read_bytes())
    except C3dError as error:
        raise KeypointsError(str(error)) from None
    groups, poses = content.groups, content.poses
    names = [str(name).strip() for part in continued(groups, "POINT", "LABELS") for name in part]
    names = (names + [""] * content.points.shape[1])[: content.points.shape[1]]
    labels = [str(name).strip() for name in groups.get("ROTATION", {}).get("LABELS", [])][: poses.shape[1]]
    xyz = np.concatenate([content.points, poses[:, : len(labels), :3, 3]], axis=1)
    turns = {label: poses[:, number, :3, :3] for number, label in enumerate(labels)}
    unit = next(iter(groups.get("POINT", {}).get("UNITS", [])), "mm").strip().lower()
    start_s = content.first_frame / content.frame_rate_hz
    return PointTable((*names, *labels), xyz, content.frame_rate_hz, unit, "z", start_s, turns)
