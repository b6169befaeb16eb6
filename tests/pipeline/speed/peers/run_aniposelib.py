"""Triangulate points of known people by aniposelib: ``CALIBRATION POINTS OUT``, in an environment that has it."""

import resource
import sys
from pathlib import Path

import numpy as np
from aniposelib.cameras import CameraGroup


def main(calibration: Path, points: Path, out: Path) -> None:
    """Write positions in metres and seconds of a core of both ways, all views at once and medians of pairs (``fast``).

    Points are of cameras and places, in distorted pixels, NaN where a camera does not see them.
    """
    group = CameraGroup.load(str(calibration))
    points_px = np.load(points)
    content = {}
    for name, fast in (("all", False), ("fast", True)):
        group.triangulate(points_px[:, :100], fast=fast)  # compiles
        started_s = core_s()
        content[f"xyz_m_{name}"] = group.triangulate(points_px, fast=fast)
        content[f"core_s_{name}"] = np.array(core_s() - started_s)
    np.savez(out, **content)


def core_s() -> float:
    """Seconds of a core that this process has taken."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:4]))
