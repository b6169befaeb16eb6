"""TRC files, as OpenSim reads them: positions of a person's joints as markers, metres, Y up.

x, y, z are the world's x, z, -y, as in BVH. A joint that is unknown in a frame is ``nan``, for there are readers that
skip empty cells. Times are on the session's clock; numbers are rounded to 0.01 mm and 1 us.
"""

from collections.abc import Iterator

import numpy as np

from pipeline.data import Timebase, Track3D
from pipeline.export.axes import Y_UP_FROM_WORLD
from pipeline.joints import JointSet


def encode(track: Track3D, joints: JointSet, timebase: Timebase, file_name: str) -> bytes:
    """Write a track's positions as TRC.

    Parameters
    ----------
    joints
        Of the track.
    file_name
        What the file will be called: it says so itself.
    """
    return ("\n".join(_lines(track, joints, timebase, file_name)) + "\n").encode("utf-8")


def _lines(track: Track3D, joints: JointSet, timebase: Timebase, file_name: str) -> Iterator[str]:
    rate = np.format_float_positional(timebase.frame_rate_hz)
    num_frames, num_joints = track.xyz_m.shape[:2]
    yield f"PathFileType\t4\t(X/Y/Z)\t{file_name}"
    yield "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames"
    yield f"{rate}\t{rate}\t{num_frames}\t{num_joints}\tm\t{rate}\t1\t{num_frames}"
    yield "Frame#\tTime\t" + "\t".join(f"{name}\t\t" for name in joints.names)
    yield "\t\t" + "\t".join(f"X{k}\tY{k}\tZ{k}" for k in range(1, num_joints + 1))
    yield ""
    for number, xyz_m in enumerate(track.xyz_m @ Y_UP_FROM_WORLD.T):
        # Adding zero turns -0.0 into 0.0.
        cells = [f"{value:.5f}" for value in (np.round(xyz_m, 5) + 0.0).ravel()]
        yield f"{number + 1}\t{timebase.time_s(track.start_frame + number):.6f}\t" + "\t".join(cells)
