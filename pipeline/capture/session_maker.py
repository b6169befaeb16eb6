"""Sessions from arrays in memory, for notebooks."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pipeline.capture.keypoint_arrays import keypoints_from_arrays
from pipeline.capture.keypoints import KeypointSession
from pipeline.core.data.cameras import Camera
from pipeline.core.options.arguments import checked
from pipeline.core.paths import StrPath


class SessionMaker:
    """Makers of capture sessions from arrays; ``multicap.Session`` is its public name.

    Methods
    -------
    from_arrays
        2D joints of calibrated cameras.

    Examples
    --------
    >>> import multicap
    >>> keypoints_px = np.full((2, 25, 1, 17, 2), np.nan)  # two cameras, 25 frames, one person, COCO's joints
    >>> keypoints_px[:] = np.linspace(100, 900, 34).reshape(17, 2)
    >>> session = multicap.Session.from_arrays(
    ...     keypoints_px[:, :, 0], None, multicap.read_calibration(folder / "calibration.json")[:2], frame_rate_hz=25.0
    ... )
    >>> session.timebase.num_frames, session.joints.names[0]
    (25, 'nose')
    """

    @staticmethod
    @checked
    def from_arrays(
        keypoints_px: Mapping[str, Any] | Sequence[Any] | np.ndarray,
        scores: Mapping[str, Any] | Sequence[Any] | np.ndarray | None,
        cameras: Sequence[Camera] | StrPath,
        frame_rate_hz: float | None = None,
        times_s: Mapping[str, Any] | Sequence[float] | np.ndarray | None = None,
        joints: Sequence[str] | str | None = None,
    ) -> KeypointSession:
        """Make a session from 2D joints that another program detected.

        Parameters
        ----------
        keypoints_px
            Distorted pixels (frames, people, joints, 2) by the camera's name or in the cameras' order; NaN where a
            joint was not detected. Rows of people are in any order.
        scores
            Confidences in [0, 1], without the last axis; ``None``: 1 for each finite joint.
        cameras
            Calibrated cameras, or the path of a calibration.
        frame_rate_hz, times_s
            Rate of all cameras, or seconds of each frame on a common clock, by the camera's name if they differ.
        joints
            Names of the points, or a layout such as ``halpe-26``; ``None``: the number of points tells it.

        Raises
        ------
        InputError
            With all problems of all arguments.
        """
        return keypoints_from_arrays(keypoints_px, scores, cameras, frame_rate_hz, times_s, joints)
