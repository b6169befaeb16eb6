"""SLEAP's analysis file: arrays of the tracks of one video.

``tracks`` has positions, NaN where a point was not found; ``point_scores`` their scores, which old files lack, and
which are NaN for points labelled by hand; ``node_names`` the names of the points. The axes are track, xy, node and
frame, or as the attribute ``dims`` states. Formats: https://docs.sleap.ai (analysis HDF5), https://io.sleap.ai
(``save_analysis_h5``)
"""

import json
from collections.abc import Sequence

import h5py
import numpy as np

from pipeline.capture.keypoint_files.hdf5.nodes import attribute, dataset, names_in, text, texts, values
from pipeline.capture.keypoint_files.hdf5.tracks import Tracks
from pipeline.capture.keypoint_files.people import KeypointsError, check_frames
from pipeline.capture.keypoint_files.points import joint_of, named_layout
from pipeline.core.parsing import UnreadableError

_AXES = ("frame", "track", "node", "xy")
_MATLAB = ("track", "xy", "node", "frame")
_UNTURNED = ("frame", "node", "xy", "track")


def is_analysis(file: h5py.File) -> bool:
    """Test for the arrays of an analysis in a file."""
    return {"tracks", "node_names"} <= set(names_in(file))


def read(file: h5py.File) -> Tracks:
    """Read the tracks of the points that are joints; frames count from 0.

    Raises ``KeypointsError`` if the arrays can't be used, ``UnreadableError`` if they are damaged.
    """
    names = texts(values(file, "node_names"))
    tracks = dataset(file, "tracks")
    if tracks is None or tracks.dtype.kind not in "fiu":
        raise UnreadableError
    axes = _axes_of(file, tracks)
    sizes = dict(zip(axes, tracks.shape, strict=False))
    if len(axes) != tracks.ndim or (sizes["node"], sizes["xy"]) != (len(names), 2):
        shape = " x ".join(map(str, tracks.shape))
        raise KeypointsError(f"tracks is {shape}; {' x '.join(axes)} of {len(names)} nodes are required.", "tracks")
    check_frames(sizes["frame"])
    positions = _turned(np.asarray(tracks[()], np.float64), axes, _AXES)
    scores = np.ones(positions.shape[:3])
    stored = values(file, "point_scores")
    if stored is not None and stored.dtype.kind in "fiu":
        of_scores = [axis for axis in axes if axis != "xy"]
        if stored.shape != tuple(sizes[axis] for axis in of_scores):
            raise KeypointsError("point_scores has other sizes than tracks.", "point_scores")
        stored = _turned(stored.astype(np.float64), of_scores, _AXES[:3])
        scores = np.where(np.isnan(stored), 1.0, stored)
    joints = [k for k, name in enumerate(names) if joint_of(name)]
    layout = named_layout([names[k] for k in joints], "node_names")
    points = np.concatenate([positions[:, :, joints], scores[:, :, joints, None]], axis=-1)
    return Tracks("SLEAP", layout, range(sizes["frame"]), points)


def _axes_of(file: h5py.File, tracks: h5py.Dataset) -> Sequence[str]:
    stated = text(attribute(tracks, "dims"))
    if stated is not None:
        try:
            axes = json.loads(stated)
        except ValueError as error:
            raise UnreadableError from error
        if not isinstance(axes, list) or sorted(map(str, axes)) != sorted(_AXES):
            raise KeypointsError(f"dims must list the axes {', '.join(_AXES)}.", "dims")
        return axes
    turned = attribute(file, "transpose")
    return _MATLAB if turned is None or turned else _UNTURNED


def _turned(array: np.ndarray, axes: Sequence[str], wanted: Sequence[str]) -> np.ndarray:
    return array.transpose([axes.index(axis) for axis in wanted])
