"""Human bodies of ``motion.json``: a coarse mesh, and its shape for each person."""

import base64
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from pipeline.core.data.animation import Floor, SkeletonMotion
from pipeline.motion.body.joints import BODY_JOINTS, MIDDLE_TWIST_RAD, TWIST_JOINTS
from pipeline.motion.body.makehuman import FULL_WEIGHT, UNITS_PER_M
from pipeline.motion.body.shape import BodyShapes, shape_body, standing_ankle_m
from pipeline.motion.skeleton.model import INDEX, WHOLE_SKELETON


def describe_body(shapes: BodyShapes) -> Mapping[str, Any]:
    """Describe what bodies of all people have in common. ``shapes`` are coarse."""
    return {
        "joints": BODY_JOINTS,
        "twists": [
            {"name": twist.name, "parent": twist.parent, "hand": twist.hand, "share": twist.share}
            for twist in TWIST_JOINTS
        ],
        "middle_twist_rad": MIDDLE_TWIST_RAD,
        "step_m": 1.0 / UNITS_PER_M,
        "triangles": _in_base64(shapes.triangles, "<u2"),
        "carriers": _in_base64(shapes.carriers, "u1"),
        "weights": _in_base64(np.rint(shapes.weights * FULL_WEIGHT), "u1"),
    }


def describe_shape(shapes: BodyShapes, motion: SkeletonMotion, floor: Floor | None) -> Mapping[str, str]:
    """Describe the shape of a person's body at rest: its vertices and joints."""
    shaped = shape_body(shapes, motion.bone_length_m, standing_ankle_m(motion, floor))
    return {
        "vertices": _in_base64(_in_steps(shaped.vertices_m), "<i2"),
        "joints": _in_base64(_in_steps(_with_fingers(shaped.joints_m)), "<i2"),
    }


def _with_fingers(joints_m: Float[np.ndarray, "joints 3"]) -> Float[np.ndarray, "all_joints 3"]:
    """Positions of all joints of bodies; joints of fingers that a skeleton has not are at the wrist."""
    num_joints = len(joints_m) - len(TWIST_JOINTS)
    wrists = [
        INDEX[f"{'Left' if joint.name.startswith('Left') else 'Right'}Hand"] for joint in WHOLE_SKELETON[num_joints:]
    ]
    return np.concatenate([joints_m[:num_joints], joints_m[wrists], joints_m[num_joints:]])


def _in_steps(positions_m: Float[np.ndarray, "positions 3"]) -> Float[np.ndarray, "positions 3"]:
    return np.rint(positions_m * UNITS_PER_M)


def _in_base64(values: np.ndarray, kind: str) -> str:
    return base64.b64encode(values.astype(kind).tobytes()).decode("ascii")
