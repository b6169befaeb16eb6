"""Compiled loops that fill gaps in whole tracks."""

from typing import no_type_check

from pipeline.data import Source
from pipeline.runtime.jit import kernel

_ABSENT, _MEASURED, _INTERPOLATED = int(Source.ABSENT), int(Source.MEASURED), int(Source.INTERPOLATED)


@kernel
@no_type_check
def fill_gaps(xyz_m, max_gap, last_known, source):
    """Interpolate linearly, in place, over gaps of at most ``max_gap`` frames between two known positions.

    Parameters
    ----------
    xyz_m
        World coordinates in metres, (frames, joints, 3), NaN where a joint is unknown; changed in place.
    last_known
        Workspace, (joints,) of -1.
    source
        Output: source of each joint, (frames, joints) of ``data.Source``.
    """
    for frame in range(xyz_m.shape[0]):
        for k in range(xyz_m.shape[1]):
            if xyz_m[frame, k, 0] != xyz_m[frame, k, 0]:
                source[frame, k] = _ABSENT
                continue
            source[frame, k] = _MEASURED
            left = last_known[k]
            if left >= 0 and 1 < frame - left <= max_gap + 1:
                for missed in range(left + 1, frame):
                    share = (missed - left) / (frame - left)
                    source[missed, k] = _INTERPOLATED
                    for axis in range(3):
                        xyz_m[missed, k, axis] = (1 - share) * xyz_m[left, k, axis] + share * xyz_m[frame, k, axis]
            last_known[k] = frame
