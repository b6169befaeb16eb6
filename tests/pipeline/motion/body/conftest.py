"""The installed human body, and bodies in poses."""

import numpy as np
import pytest

from pipeline.motion.body import installed
from pipeline.motion.body.joints import about, blend, placed, world_from_joints
from pipeline.motion.body.shape import BodyShapes, ShapedBody
from pipeline.motion.skeleton.model import WHOLE_SKELETON


@pytest.fixture(scope="session")
def shapes() -> BodyShapes:
    installed.install()
    return installed.load()


def adult_lengths_m(stature_m: float = 1.75, num_joints: int = len(WHOLE_SKELETON)) -> np.ndarray:
    """Lengths of the bones of a person with the proportions of the average."""
    return np.array([joint.stature_share for joint in WHOLE_SKELETON[:num_joints]]) * stature_m


def in_pose(body: ShapedBody, parent_from_joint: np.ndarray, root_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """World positions of a body's vertices and joints in a pose of its skeleton."""
    turns = world_from_joints(parent_from_joint)
    places_m = placed(turns, body.joints_m)
    places_m += root_m - places_m[0]
    return blend(body.vertices_m, body.carriers, body.weights, about(turns, body.joints_m, places_m)), places_m
