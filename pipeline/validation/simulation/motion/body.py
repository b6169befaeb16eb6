"""Articulated body model: segment lengths of a person, and joint positions from a pose.

Trunk and head are rigid and rotated by angles; arms and legs reach for wrist and ankle targets with two segments. So
bone lengths are constant, and a standing foot does not move. Lengths are shares of stature (Drillis and Contini 1966,
table of body segment lengths; the face after adult means).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from pipeline.core.joints import COCO_17, SIDES
from pipeline.motion.body_segments import WORLD

STANDING_LEG = 0.985
"""Height of the hips above the ankles of a standing person, as a share of the leg's length."""

# Limits of the distance from shoulder to wrist and from hip to ankle, as shares of the limb's length: the bend of a
# straight or folded limb would have no direction.
_STRAIGHTEST = 0.995
_MOST_BENT = 0.25
# Directions of the left elbow and the left knee in the trunk's axes (ahead, left, up).
_ELBOW_POLE = np.array([-0.4, 0.5, -0.75])
_KNEE_POLE = np.array([1.0, 0.15, 0.0])
# Share of the trunk's lean that the head keeps, so that people look ahead.
_HEAD_LEAN = 0.4
_SIDES = np.array([1.0, -1.0])


@dataclass(frozen=True, slots=True)
class Proportions:
    """Segment lengths of a person in metres, between joint centres as detectors mark them."""

    stature_m: float
    shin_m: float
    thigh_m: float
    hip_width_m: float
    trunk_m: float
    shoulder_width_m: float
    upper_arm_m: float
    forearm_m: float
    neck_m: float
    ankle_height_m: float

    @property
    def leg_m(self) -> float:
        """Length of a straight leg."""
        return self.thigh_m + self.shin_m

    @property
    def arm_m(self) -> float:
        """Length of a straight arm."""
        return self.upper_arm_m + self.forearm_m

    @property
    def shoulder_height_m(self) -> float:
        """Height of the shoulders of the standing person."""
        return self.ankle_height_m + STANDING_LEG * self.leg_m + self.trunk_m


def random_proportions(rng: np.random.Generator) -> Proportions:
    """Draw a stature between 1.50 m and 1.95 m, and segments that differ from the mean by a few percent."""
    stature_m = float(np.clip(rng.normal(1.72, 0.10), 1.50, 1.95))

    def segment(share: float) -> float:
        return float(stature_m * share * np.clip(rng.normal(1.0, 0.03), 0.92, 1.08))

    return Proportions(
        stature_m=stature_m,
        shin_m=segment(0.246),
        thigh_m=segment(0.245),
        hip_width_m=segment(0.130),
        trunk_m=segment(0.288),
        shoulder_width_m=segment(0.215),
        upper_arm_m=segment(0.172),
        forearm_m=segment(0.150),
        neck_m=segment(0.118),
        ankle_height_m=segment(0.050),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """Pose of a body over time."""

    hips_m: Float[np.ndarray, "times 3"]  # Centre of the hips in the world
    yaw_rad: Float[np.ndarray, " times"]  # Heading of the hips; 0 is along X, positive to the left
    lean_rad: Float[np.ndarray, " times"]  # Lean of the trunk forward
    twist_rad: Float[np.ndarray, " times"]  # Rotation of the shoulders to the left, relative to the hips
    gaze_rad: Float[np.ndarray, "times 2"]  # Rotation of the head to the left, and its nod, relative to the shoulders
    ankles_m: Float[np.ndarray, "times 2 3"]  # Targets of the left and the right ankle in the world
    # Targets of the left and the right wrist relative to the shoulder, in lengths of the arm, along upright axes
    # (ahead, left, up) with the heading of the shoulders
    wrists: Float[np.ndarray, "times 2 3"]


def turned(yaw_rad: Float[np.ndarray, " times"], pitch_rad: Float[np.ndarray, " times"]) -> np.ndarray:
    """Rotation matrices (times, 3, 3) of a pitch forward about Y, followed by a yaw to the left about Z."""
    cos_yaw, sin_yaw, cos_pitch, sin_pitch = np.cos(yaw_rad), np.sin(yaw_rad), np.cos(pitch_rad), np.sin(pitch_rad)
    zero = np.zeros_like(cos_yaw)
    return np.stack(
        [
            np.stack([cos_yaw * cos_pitch, -sin_yaw, cos_yaw * sin_pitch], axis=-1),
            np.stack([sin_yaw * cos_pitch, cos_yaw, sin_yaw * sin_pitch], axis=-1),
            np.stack([-sin_pitch, zero, cos_pitch], axis=-1),
        ],
        axis=-2,
    )


def reach(
    origin_m: Float[np.ndarray, "*batch 3"],
    target_m: Float[np.ndarray, "*batch 3"],
    upper_m: float,
    lower_m: float,
    pole: Float[np.ndarray, "*batch 3"],
) -> tuple[Float[np.ndarray, "*batch 3"], Float[np.ndarray, "*batch 3"]]:
    """Inverse kinematics of two segments from an origin to a target, bent towards a pole.

    Returns world positions of the middle joint and of the end; for a target out of reach the end is in its direction.
    """
    towards = target_m - origin_m
    length_m = upper_m + lower_m
    asked_m = np.linalg.norm(towards, axis=-1, keepdims=True)
    direction = towards / np.maximum(asked_m, 1e-9)
    distance_m = np.clip(asked_m, _MOST_BENT * length_m, _STRAIGHTEST * length_m)
    along_m = (upper_m**2 - lower_m**2 + distance_m**2) / (2 * distance_m)
    aside = pole - (pole * direction).sum(-1, keepdims=True) * direction
    aside = aside / np.linalg.norm(aside, axis=-1, keepdims=True)
    middle_m = origin_m + along_m * direction + np.sqrt(upper_m**2 - along_m**2) * aside
    return middle_m, origin_m + distance_m * direction


def pose_joints(body: Proportions, pose: Pose) -> Float[np.ndarray, "times 17 3"]:
    """World positions of the joints of ``COCO_17`` in metres."""
    heading_rad = pose.yaw_rad + pose.twist_rad
    pelvis = turned(pose.yaw_rad, np.zeros_like(pose.yaw_rad))
    upright = turned(heading_rad, np.zeros_like(heading_rad))
    trunk, head = _trunk_and_head(pose)

    neck_m = pose.hips_m + body.trunk_m * trunk[:, :, 2]
    shoulders_m = _both_sides(neck_m, trunk, body.shoulder_width_m)
    hips_m = _both_sides(pose.hips_m, pelvis, body.hip_width_m)
    elbows_m, wrists_m = reach(
        shoulders_m,
        shoulders_m + body.arm_m * np.einsum("tab,tsb->tsa", upright, pose.wrists),
        body.upper_arm_m,
        body.forearm_m,
        _mirrored(upright, _ELBOW_POLE),
    )
    knees_m, ankles_m = reach(hips_m, pose.ankles_m, body.thigh_m, body.shin_m, _mirrored(pelvis, _KNEE_POLE))
    # The ears lie above the neck's upper end, the face ahead of them.
    ears_m = neck_m + body.neck_m * trunk[:, :, 2]
    face = np.array(
        [[0.062, 0.0, -0.012], [0.052, 0.018, 0.012], [0.052, -0.018, 0.012], [0, 0.044, 0], [0, -0.044, 0]]
    )
    face_m = ears_m[:, None] + body.stature_m * np.einsum("tab,kb->tka", head, face)
    pairs = [shoulders_m, elbows_m, wrists_m, hips_m, knees_m, ankles_m]
    return np.concatenate([face_m, *pairs], axis=1)


def segment_frames(pose: Pose, joints_m: Float[np.ndarray, "times 17 3"]) -> dict[str, Float[np.ndarray, "times 3 3"]]:
    """Exact orientations ``world_from_segment`` of the body's segments, without feet and hands; see ``angles``.

    The trunk is rigid but for its twist, so the pelvis leans with it. ``joints_m`` are the joints of the pose: planes
    in which limbs bend are theirs.
    """
    trunk, head = _trunk_and_head(pose)
    segments = {"pelvis": turned(pose.yaw_rad, pose.lean_rad) @ WORLD, "thorax": trunk @ WORLD, "head": head @ WORLD}
    for side in SIDES:
        for upper, lower, names, forward in (
            ("thigh", "shank", ("hip", "knee", "ankle"), 1.0),
            ("upper_arm", "forearm", ("shoulder", "elbow", "wrist"), -1.0),
        ):
            start_m, middle_m, end_m = (joints_m[:, COCO_17.index(f"{side}_{name}")] for name in names)
            # The knee points to the front, the elbow to the back; to the front times up is to the right.
            right = forward * np.cross(middle_m - start_m, start_m - end_m)
            segments[f"{side}_{upper}"] = _along(start_m - middle_m, right)
            segments[f"{side}_{lower}"] = _along(middle_m - end_m, right)
    return segments


def _along(
    upwards: Float[np.ndarray, "times 3"], right: Float[np.ndarray, "times 3"]
) -> Float[np.ndarray, "times 3 3"]:
    """Orientations of segments by their Y axis and their Z axis, which are at right angles."""
    y, z = (vector / np.linalg.norm(vector, axis=-1, keepdims=True) for vector in (upwards, right))
    return np.stack([np.cross(y, z), y, z], axis=-1)


def _trunk_and_head(pose: Pose) -> tuple[Float[np.ndarray, "times 3 3"], Float[np.ndarray, "times 3 3"]]:
    heading_rad = pose.yaw_rad + pose.twist_rad
    nod_rad = _HEAD_LEAN * pose.lean_rad + pose.gaze_rad[:, 1]
    return turned(heading_rad, pose.lean_rad), turned(heading_rad + pose.gaze_rad[:, 0], nod_rad)


def _both_sides(center_m: np.ndarray, axes: np.ndarray, width_m: float) -> Float[np.ndarray, "times 2 3"]:
    """Points half a width to the left and to the right of a centre."""
    return center_m[:, None] + width_m / 2 * _SIDES[:, None] * axes[:, None, :, 1]


def _mirrored(axes: np.ndarray, left_pole: np.ndarray) -> Float[np.ndarray, "times 2 3"]:
    """Convert a direction in the body's axes to world directions, for the left side and mirrored for the right side."""
    poles = left_pole * np.stack([np.ones(2), _SIDES, np.ones(2)], axis=-1)
    return np.einsum("tab,sb->tsa", axes, poles)
