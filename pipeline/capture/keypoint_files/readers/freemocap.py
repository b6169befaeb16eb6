"""Reader of FreeMoCap's 2D points: an array of NumPy's, frames x points x 2 or 3, of one person in a camera.

FreeMoCap writes cameras x frames x points x 3 into one file, of which a camera's part is read. With MediaPipe's points
(33 of the pose, then perhaps 21 of the right hand, 21 of the left, and the face) x and y are shares of the image times
its size, and the third number is a depth. Points of other networks have a score in its place, or nothing. Points that
were not found are not finite, or at (0, 0). Format: https://github.com/freemocap/skellytracker (recorders of the
trackers)

Rows of the table of formats:

| FreeMoCap | all frames: the array of a camera (`.npy`), frames x points x 3, of one person; or one file of all cameras
| MediaPipe's 33, and hands; or BODY_25, COCO-17 and the other layouts of OpenPose | the file of all cameras needs
`--pair-by-order`; or save `array[k]` in the folder of camera k; the service takes it as the only part `keypoints` |
"""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pipeline.capture.keypoint_files.keypoint_reader import reader
from pipeline.capture.keypoint_files.people import KeypointsError, People, check_frames
from pipeline.capture.keypoint_files.points import CANDIDATES, KeypointReading
from pipeline.core.joints import WHOLE_BODY
from pipeline.core.layouts import HAND_POINTS, LAYOUTS, KeypointLayout

_POSE = LAYOUTS["mediapipe-33"]
_POSE_AND_HANDS = KeypointLayout(
    "mediapipe-75", (*_POSE.points, *HAND_POINTS["right"], *HAND_POINTS["left"]), WHOLE_BODY
)
_NUM_POSE, _NUM_HOLISTIC = len(_POSE.points), len(_POSE_AND_HANDS.points)
_MAX_CAMERAS = 1000
_MAGIC = b"\x93NUMPY"
_NUMS_FACE = (0, 468, 478)
MEDIAPIPE: Mapping[int, KeypointLayout] = {
    _NUM_POSE: _POSE,
    **{_NUM_HOLISTIC + num_face: _POSE_AND_HANDS for num_face in _NUMS_FACE},
}


class CameraArray(NamedTuple):
    """Part of a camera in the file of all cameras."""

    path: Path
    array: np.ndarray  # Frames x points x 2 or 3

    @property
    def name(self) -> str:
        """Name of the file."""
        return self.path.name


def file_of_cameras(files: Iterable[Path]) -> Path | None:
    """File of the 2D points of all cameras among the files of a recording; ``None`` without one, or with several."""
    arrays = [path for path in files if path.suffix.lower() == ".npy"]
    named = [path for path in arrays if "2ddata" in path.name.casefold()] or arrays
    return named[0] if len(named) == 1 else None


def split_cameras(path: Path) -> dict[str, CameraArray]:
    """Split the file of all cameras, by names that no camera has: ``part1`` and so on.

    Raises ``KeypointsError`` if the file is no array of cameras.
    """
    array = opened(path)
    if array.ndim != 4:
        message = (
            "The array must have the axes cameras, frames, points, and x, y and score; else give each camera its own"
        )
        raise KeypointsError(f"{message} in a folder with its name.")
    if len(array) > _MAX_CAMERAS:
        raise KeypointsError(f"The array has {len(array):,} cameras; at most {_MAX_CAMERAS} are allowed.")
    return {f"part{k + 1}": CameraArray(path, part) for k, part in enumerate(array)}


def opened(path: Path) -> np.ndarray:
    """Open the array of a file, which stays on disk; nothing in it is run.

    Raises ``KeypointsError`` if the file is not an array of numbers.
    """
    with path.open("rb") as file:
        is_array = file.read(len(_MAGIC)) == _MAGIC  # and not an archive or a pickle
    try:
        array: Any = np.load(path, mmap_mode="r", allow_pickle=False) if is_array else None
    except OSError:
        raise
    except Exception:  # NumPy's reader passes on all kinds of exceptions for a damaged header
        array = None
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiu":
        raise KeypointsError("The file is not an array of numbers in NumPy's form (.npy).")
    return array


def split_frames(content: np.ndarray) -> Mapping[int, np.ndarray]:
    """Split an array of a camera by frames, which count from 0."""
    if content.ndim == 4:
        message = f"The array holds {len(content)} cameras; save array[k] in the folder of its camera, or give the file"
        raise KeypointsError(f"{message} alone, without folders.")
    if content.ndim != 3 or content.shape[2] not in (2, 3):
        shape = " x ".join(map(str, content.shape))
        raise KeypointsError(f"The array is {shape or 'a number'}; frames x points x 3 are required.")
    check_frames(len(content))
    num_points = content.shape[1]
    if num_points not in MEDIAPIPE and num_points not in CANDIDATES:
        known = ", ".join(map(str, sorted({*MEDIAPIPE, *CANDIDATES})))
        raise KeypointsError(f"The array has {num_points} points a frame; known numbers are {known}.")
    if num_points in MEDIAPIPE:
        content = content[:, :_NUM_HOLISTIC, :2]
    elif not _has_scores(content):
        content = content[..., :2]
    return dict(enumerate(content))


@reader("FreeMoCap", suffixes=(".npy",), load=opened, split_frames=split_frames)
def read_frame(content: np.ndarray, reading: KeypointReading) -> People:
    """Read the person of a frame, or no person without a detected joint."""
    points = np.ones((1, len(content), 3))
    points[0, :, : content.shape[1]] = content
    found = np.isfinite(points).all(-1) & (points[..., :2] != 0).any(-1)
    points[~found] = 0.0
    layout = MEDIAPIPE.get(len(content)) or reading.layout(len(content), "points")
    if len(content) in MEDIAPIPE:
        # Shares reach from edge to edge of the image, and pixel 0 has its centre half a pixel from the edge.
        points[found, :2] -= 0.5
    return reading.people(points, layout)


def _has_scores(content: np.ndarray) -> bool:
    """The third number of the points is a score, as not all are missing; raises ``KeypointsError`` if it is none."""
    if content.shape[2] < 3:
        return False
    scores = np.asarray(content[..., 2], dtype=np.float64)
    scores = scores[np.isfinite(scores)]
    if ((scores < 0) | (scores > 1)).any():
        raise KeypointsError("The third number of the points must be a score from 0 to 1.")
    return bool(scores.any())
