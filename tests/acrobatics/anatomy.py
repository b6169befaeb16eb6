"""Acrobat's body: angles of its joints, their limits, and positions of its points.

Axes of all parts in the rest pose are ahead, left and up; the person stands with hanging arms. Angles of limbs are the
same on both sides for mirrored poses.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from jaxtyping import Float

from pipeline.core.joints import BODY_FEET
from pipeline.validation.simulation.motion.body import Proportions
from pipeline.validation.simulation.motion.feet import FootShape

# Limits in degrees: the ranges of gymnasts. Knees reach 165 degrees in kneeling on the heels.
_LIMITS_DEG: Mapping[str, tuple[float, float]] = {
    # Orientation of the pelvis in the world: heading to the left, pitch ahead, roll to the right.
    "yaw": (-np.inf, np.inf),
    "pitch": (-np.inf, np.inf),
    "roll": (-np.inf, np.inf),
    # Bends of the back, shared by both halves: ahead, to the right, twist to the left.
    "spine_bend": (-50.0, 95.0),
    "spine_side": (-40.0, 40.0),
    "spine_twist": (-50.0, 50.0),
    "nod": (-65.0, 65.0),
    "head_twist": (-70.0, 70.0),
}
_LIMB_LIMITS_DEG: Mapping[str, tuple[float, float]] = {
    # Upper arm: raised ahead, raised aside, twisted outwards; bend of the elbow.
    "arm_raise": (-60.0, 195.0),
    "arm_aside": (-35.0, 120.0),
    "arm_twist": (-90.0, 90.0),
    "elbow": (0.0, 150.0),
    # Thigh: raised ahead, raised aside, twisted outwards; bend of the knee; toes pointed.
    "leg_raise": (-35.0, 145.0),
    "leg_aside": (-25.0, 80.0),
    "leg_twist": (-45.0, 60.0),
    "knee": (0.0, 165.0),
    "point_toes": (-35.0, 80.0),
}
ANGLE_LIMITS_DEG: Mapping[str, tuple[float, float]] = MappingProxyType(
    {
        **_LIMITS_DEG,
        **{f"{side}_{name}": limits for side in ("left", "right") for name, limits in _LIMB_LIMITS_DEG.items()},
    }
)
"""Smallest and largest angle of each joint in degrees, in the order of the arrays of angles."""
ANGLE_NAMES = tuple(ANGLE_LIMITS_DEG)

POINTS = (*BODY_FEET.names, "left_back", "right_back")
"""Points of an acrobat: the joints of ``BODY_FEET``, and two points in the middle of the back."""

_OUTWARDS = {"left": 1.0, "right": -1.0}

# Distances in metres from points of an adult to the surface of the body.
_FLESH_M: Mapping[str, float] = {
    "nose": 0.03, "eye": 0.04, "ear": 0.085, "shoulder": 0.06, "elbow": 0.035, "wrist": 0.03, "hip": 0.09,
    "knee": 0.05, "ankle": 0.045, "heel": 0.0, "toe": 0.0, "back": 0.09,
}  # fmt: skip
CLEARANCE_M: Float[np.ndarray, " points"] = np.array([_FLESH_M[name.rpartition("_")[2]] for name in POINTS])
"""Least height of each point above a floor on which the body lies, in metres."""

# Share of the trunk below the middle of the back.
_LUMBAR = 0.4
# Nose, eyes and ears from the centre between the ears, as shares of stature.
_FACE = np.array([[0.062, 0.0, -0.012], [0.052, 0.018, 0.012], [0.052, -0.018, 0.012], [0, 0.044, 0], [0, -0.044, 0]])


@dataclass(frozen=True, slots=True)
class AcrobatBody:
    """Body of an acrobat: lengths of segments and size of the feet."""

    proportions: Proportions
    feet: FootShape


def _about(axis: int, angle_rad: Float[np.ndarray, " times"]) -> Float[np.ndarray, "times 3 3"]:
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    matrices = np.zeros((len(angle_rad), 3, 3))
    first, second = (axis + 1) % 3, (axis + 2) % 3
    matrices[:, axis, axis] = 1.0
    matrices[:, first, first] = matrices[:, second, second] = cos
    matrices[:, first, second], matrices[:, second, first] = -sin, sin
    return matrices


def _pitch_roll_yaw(
    pitch_rad: Float[np.ndarray, " times"], roll_rad: Float[np.ndarray, " times"], yaw_rad: Float[np.ndarray, " times"]
) -> Float[np.ndarray, "times 3 3"]:
    """Rotation by a yaw, then by a roll about the axis ahead, then by a pitch about the axis to the left."""
    return np.asarray(_about(1, pitch_rad) @ _about(0, roll_rad) @ _about(2, yaw_rad))


def body_parts(
    angles_rad: Float[np.ndarray, "times angles"],
) -> dict[str, Float[np.ndarray, "times 3 3"]]:
    """Orientations of the body's parts in the world for the angles of ``ANGLE_NAMES``, by name.

    Axes of each part are ahead, left and up in the rest pose. Names are from ``body_segments.SEGMENTS``, and
    ``waist``, the middle of the back.
    """
    angle = dict(zip(ANGLE_NAMES, angles_rad.T, strict=True))
    pelvis = _about(2, angle["yaw"]) @ _about(1, angle["pitch"]) @ _about(0, angle["roll"])
    bend = _pitch_roll_yaw(angle["spine_bend"] / 2, angle["spine_side"] / 2, angle["spine_twist"] / 2)
    waist = pelvis @ bend
    thorax = waist @ bend
    head = thorax @ _pitch_roll_yaw(angle["nod"], np.zeros(len(angles_rad)), angle["head_twist"])
    parts = {"pelvis": pelvis, "waist": waist, "thorax": thorax, "head": head}
    for side, outwards in _OUTWARDS.items():
        limb = {name: angle[f"{side}_{name}"] for name in _LIMB_LIMITS_DEG}
        arm = thorax @ _pitch_roll_yaw(-limb["arm_raise"], outwards * limb["arm_aside"], outwards * limb["arm_twist"])
        thigh = pelvis @ _pitch_roll_yaw(-limb["leg_raise"], outwards * limb["leg_aside"], outwards * limb["leg_twist"])
        shank = thigh @ _about(1, limb["knee"])
        parts |= {
            f"{side}_upper_arm": arm,
            f"{side}_forearm": arm @ _about(1, -limb["elbow"]),
            f"{side}_thigh": thigh,
            f"{side}_shank": shank,
            f"{side}_foot": shank @ _about(1, limb["point_toes"]),
        }
    return parts


def points_m(
    body: AcrobatBody, root_m: Float[np.ndarray, "times 3"], angles_rad: Float[np.ndarray, "times angles"]
) -> Float[np.ndarray, "times points 3"]:
    """World positions of ``POINTS`` in metres, for the hips' centre and the angles of ``ANGLE_NAMES``."""
    size, part = body.proportions, body_parts(angles_rad)
    back_m = root_m + _LUMBAR * size.trunk_m * part["waist"][..., 2]
    neck_m = back_m + (1 - _LUMBAR) * size.trunk_m * part["thorax"][..., 2]
    ears_m = neck_m + size.neck_m * part["head"][..., 2]
    by_name = {
        name: ears_m + size.stature_m * part["head"] @ offset
        for name, offset in zip(BODY_FEET.names, _FACE, strict=False)
    }
    for side, outwards in _OUTWARDS.items():
        by_name[f"{side}_back"] = back_m + outwards * 0.2 * size.shoulder_width_m * part["waist"][..., 1]
        shoulder_m = neck_m + outwards * size.shoulder_width_m / 2 * part["thorax"][..., 1]
        elbow_m = shoulder_m - size.upper_arm_m * part[f"{side}_upper_arm"][..., 2]
        wrist_m = elbow_m - size.forearm_m * part[f"{side}_forearm"][..., 2]
        hip_m = root_m + outwards * size.hip_width_m / 2 * part["pelvis"][..., 1]
        knee_m = hip_m - size.thigh_m * part[f"{side}_thigh"][..., 2]
        ankle_m = knee_m - size.shin_m * part[f"{side}_shank"][..., 2]
        foot = part[f"{side}_foot"]
        sole_m = size.ankle_height_m
        by_name |= {
            f"{side}_shoulder": shoulder_m,
            f"{side}_elbow": elbow_m,
            f"{side}_wrist": wrist_m,
            f"{side}_hip": hip_m,
            f"{side}_knee": knee_m,
            f"{side}_ankle": ankle_m,
            f"{side}_heel": ankle_m + foot @ np.array([-body.feet.heel_m, 0.0, -sole_m]),
            f"{side}_big_toe": ankle_m + foot @ np.array([body.feet.toe_m, -outwards * body.feet.inward_m, -sole_m]),
        }
    return np.stack([by_name[name] for name in POINTS], axis=1)
