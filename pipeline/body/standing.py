"""Height of a person's ankles above the floor."""

import numpy as np

from pipeline.data.animation import Floor, SkeletonMotion
from pipeline.skeleton.model import joint_pose


def standing_ankle_m(motion: SkeletonMotion, floor: Floor | None) -> float | None:
    """Median height (metres) of a person's ankles above the floor while heel and toe of the foot stand on it.

    ``None`` without a floor, or for a person who does not stand.
    """
    if floor is None:
        return None
    heights_m = []
    for side in ("left", "right"):
        stands = {part: np.zeros(len(motion.root_m), bool) for part in ("heel", "toe")}
        for contact in motion.contacts:
            if contact.side == side and contact.part in stands:
                start = contact.start_frame - motion.start_frame
                stands[contact.part][start : start + contact.num_frames] = True
        ankle_m, _ = joint_pose(motion, f"{side.capitalize()}Foot")
        heights_m.append(floor.height_m(ankle_m[stands["heel"] & stands["toe"]]))
    found_m = np.concatenate(heights_m)
    return float(np.median(found_m)) if len(found_m) else None
