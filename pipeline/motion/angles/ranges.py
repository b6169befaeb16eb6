"""Ranges of motion: how far each joint angle went, for ``metrics.json``."""

import numpy as np

from pipeline.motion.angles.compute import JointAngles
from pipeline.motion.angles.definitions import ANGLE_NAMES


def ranges_of_motion(angles: JointAngles) -> dict[str, dict[str, float | None]]:
    """Smallest and largest angle, their difference, number of frames and standard deviation of each angle, by name.

    All are in degrees, rounded to 0.01. ``sigma_deg`` is the median over frames, ``None`` where none is stated. An
    angle that was never known is left out.
    """
    found: dict[str, dict[str, float | None]] = {}
    for name, angle_deg, sigma_deg in zip(ANGLE_NAMES, angles.angle_deg.T, angles.sigma_deg.T, strict=True):
        known_deg, stated_deg = angle_deg[np.isfinite(angle_deg)], sigma_deg[np.isfinite(sigma_deg)]
        if len(known_deg):
            found[name] = {
                "min_deg": round(float(known_deg.min()), 2),
                "max_deg": round(float(known_deg.max()), 2),
                "range_deg": round(float(np.ptp(known_deg)), 2),
                "num_frames": len(known_deg),
                "sigma_deg": round(float(np.median(stated_deg)), 2) if len(stated_deg) else None,
            }
    return found
