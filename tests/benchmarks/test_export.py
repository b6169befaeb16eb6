"""Long takes of the benchmarks."""

import numpy as np

from pipeline.core.data.animation import FootContact, SkeletonMotion
from pipeline.motion.skeleton.model import SKELETON
from tests.benchmarks.export import longer_motion


def test_contacts_of_long_motion_are_where_feet_stand() -> None:
    """Each contact has the poses that the one of the short motion has."""
    root_m = np.arange(10.0)[:, None] * [1.0, 0.0, 0.0]
    quat = np.tile([0.0, 0.0, 0.0, 1.0], (10, len(SKELETON), 1))
    contacts = FootContact("left", 1, 3, 1.0, True, 0.0, 0.0), FootContact("right", 6, 4, 1.0, True, 0.0, 0.0)
    motion = SkeletonMotion(7, "a", 5, 25.0, np.ones(len(SKELETON)), root_m, quat, contacts)
    longer = longer_motion(motion, 2, 35)
    assert (longer.track_id, longer.start_frame, len(longer.root_m)) == (2, 0, 35)
    found = [(contact.side, longer.root_m[contact.rows, 0].tolist()) for contact in longer.contacts]
    left, right = ("left", [1.0, 2.0, 3.0]), ("right", [6.0, 7.0, 8.0, 9.0])
    back_left, back_right = ("left", [3.0, 2.0, 1.0]), ("right", [9.0, 8.0, 7.0, 6.0])
    assert found == [left, right, back_right, back_left, left, right, back_right]
