"""Sessions from arrays in memory and from files of 3D points."""

from pipeline.capture.keypoint_arrays import from_arrays
from pipeline.capture.points import from_points, open_points


class SessionMaker:
    """Makers of capture sessions from arrays; ``multicap.Session`` is its public name.

    Methods
    -------
    from_arrays
        2D joints of calibrated cameras.
    from_points, from_files
        3D points of people, in memory or in files of other systems.

    Examples
    --------
    >>> import multicap
    >>> import numpy as np
    >>> cameras = multicap.read_calibration(folder / "calibration.json")
    >>> keypoints_px = np.tile(np.linspace(100, 900, 34).reshape(17, 2), (3, 25, 1, 1))  # a person, 25 frames
    >>> session = multicap.Session.from_arrays(keypoints_px, None, cameras, 25.0, joints="coco-17")
    >>> session.timebase.num_frames, session.joints.names[0]
    (25, 'nose')
    """

    from_arrays = staticmethod(from_arrays)
    from_points = staticmethod(from_points)
    from_files = staticmethod(open_points)
