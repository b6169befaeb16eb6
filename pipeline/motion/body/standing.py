"""Height of a person's ankles above the floor."""

import numpy as np

from pipeline.core.data.animation import Floor, SkeletonMotion
from pipeline.motion.skeleton.model import INDEX, joint_pose, rest_offsets_m

# Heights as multiples of the skeleton's at rest: who stands lower or higher stands on something else than the floor,
# such as a step or a treadmill.
_LOWEST, _HIGHEST = 0.5, 2.0


def standing_ankle_m(motion: SkeletonMotion, floor: Floor | None) -> float | None:
    """Median height (metres) of a person's ankles above the floor while heel and toe of the foot stand on it.

    ``None`` without a floor, for a person who does not stand, and for one whose feet stand elsewhere than on the floor.
    """
    if floor is None:
        return None
    heights_m = []
    for side in ("left", "right"):
        stands = {part: np.zeros(len(motion.root_m), bool) for part in ("heel", "toe")}
        for contact in motion.contacts:
            if contact.side == side and contact.part in stands:
                stands[contact.part][contact.rows] = True
        ankle_m, _ = joint_pose(motion, f"{side.capitalize()}Foot")
        heights_m.append(floor.height_m(ankle_m[stands["heel"] & stands["toe"]]))
    found_m = np.concatenate(heights_m)
    usual_m = -rest_offsets_m(motion.bone_length_m)[INDEX["LeftFootEnd"], 2]
    median_m = float(np.median(found_m)) if len(found_m) else np.nan
    return median_m if _LOWEST * usual_m <= median_m <= _HIGHEST * usual_m else None
