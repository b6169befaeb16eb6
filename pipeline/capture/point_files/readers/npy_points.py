"""Reader of FreeMoCap's 3D arrays (``.npy``): frames x points x 3 of one person, or frames x people x points x 3."""

from pathlib import Path

import numpy as np

from pipeline.capture.keypoint_files.people import KeypointsError
from pipeline.capture.keypoint_files.points import CANDIDATES
from pipeline.capture.keypoint_files.readers.freemocap import MEDIAPIPE
from pipeline.capture.point_files.point_reader import MAX_NUMBERS, PointTable, flattened, point_reader


@point_reader("FreeMoCap's 3D array", ".npy")
def read_npy(path: Path) -> PointTable:
    """Read a file; the number of points tells their layout. FreeMoCap's unit is the millimetre, with Z up."""
    array = np.load(path, mmap_mode="r", allow_pickle=False)
    if array.ndim not in {3, 4} or array.shape[-1] < 3 or array.size > MAX_NUMBERS or array.dtype.kind not in "fi":
        raise KeypointsError("The array is not frames x points x 3, or frames x people x points x 3.")
    xyz = np.array(array[..., :3], np.float64)
    xyz = xyz[:, None] if xyz.ndim == 3 else xyz
    num_points = xyz.shape[2]
    layouts = [*filter(None, [MEDIAPIPE.get(num_points)]), *CANDIDATES.get(num_points, ())]
    if not layouts:
        raise KeypointsError(f"The array has {num_points} points a person, which is no layout that is read.")
    points = layouts[0].points
    names = tuple(points[k] or f"point_{k}" if k < len(points) else f"point_{k}" for k in range(num_points))
    return PointTable(**flattened([str(k + 1) for k in range(xyz.shape[1])], names, xyz))
