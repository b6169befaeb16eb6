"""Person with moving hands: joints of ``WHOLE_BODY`` by forward kinematics of the whole skeleton."""

from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import SkeletonMotion
from pipeline.core.joints import WHOLE_BODY
from pipeline.motion.skeleton.feet.floor import SIDES
from pipeline.motion.skeleton.fitting.articulation import ARM_HINGES, KNEE_HINGE
from pipeline.motion.skeleton.hands.anatomy import HINGES, joint_rotations
from pipeline.motion.skeleton.model import INDEX, WHOLE_SKELETON, forward_kinematics

RATE_HZ = 30.0
STATURE_M = 1.75
_HEAD_M = {
    "nose": (0.0, -0.11, -0.01),
    "left_eye": (0.032, -0.08, 0.02),
    "right_eye": (-0.032, -0.08, 0.02),
    "left_ear": (0.075, 0.0, 0.0),
    "right_ear": (-0.075, 0.0, 0.0),
}
_FOOT_M = {"heel": (0.0, 0.05, -0.06), "big_toe": (0.0, -0.17, -0.066)}


def _wave(time_s: np.ndarray, low: float, high: float, hz: float, phase: float) -> np.ndarray:
    return low + (high - low) * (0.5 - 0.5 * np.cos(2 * np.pi * hz * time_s + phase))


def hinge_angles_rad(num_frames: int, phase: float = 0.0) -> np.ndarray:
    """Angles of a hand's hinges: fingers open and close one after the other, and spread a little."""
    time_s = np.arange(num_frames) / RATE_HZ
    angles_deg = np.empty((num_frames, HINGES * 5))
    for finger in range(5):
        here, own = angles_deg[:, HINGES * finger : HINGES * (finger + 1)], phase + 0.5 * finger
        if finger == 0:
            here[:, 0], here[:, 1] = _wave(time_s, -15, 20, 0.3, own), _wave(time_s, -10, 25, 0.4, own)
            here[:, 2], here[:, 3] = _wave(time_s, 5, 40, 0.5, own), _wave(time_s, 5, 50, 0.5, own)
        else:
            here[:, 0], here[:, 1] = _wave(time_s, -8, 8, 0.3, own), _wave(time_s, 0, 70, 0.5, own)
            here[:, 2], here[:, 3] = _wave(time_s, 5, 85, 0.5, own), _wave(time_s, 3, 50, 0.5, own)
    return np.radians(angles_deg)


@cache
def gesturing(num_frames: int, hand_scale: float = 1.0) -> SkeletonMotion:
    """Motion of a person who stands and gestures with both arms and hands.

    Parameters
    ----------
    hand_scale
        Size of the hands, relative to adult proportions.
    """
    time_s = np.arange(num_frames) / RATE_HZ
    lengths_m = np.array([joint.stature_share for joint in WHOLE_SKELETON]) * STATURE_M
    lengths_m[24:] *= hand_scale
    quat = np.zeros((num_frames, len(WHOLE_SKELETON), 4))
    quat[..., 3] = 1.0

    def turn(name: str, rotation: Rotation) -> None:
        quat[:, INDEX[name]] = rotation.as_quat()

    for number, side in enumerate(("Left", "Right")):
        sign, phase = 1.0 - 2.0 * number, 0.7 * number
        down, ahead = _wave(time_s, 20, 50, 0.25, phase), _wave(time_s, 10, 45, 0.3, phase)
        zero = np.zeros(num_frames)
        swing = Rotation.from_euler("YZ", np.stack([sign * down, zero - sign * ahead], axis=-1), degrees=True)
        turn(f"{side}Arm", swing)
        elbow_rad = np.radians(_wave(time_s, 40, 90, 0.4, phase))
        turn(f"{side}ForeArm", Rotation.from_rotvec(elbow_rad[:, None] * np.array(ARM_HINGES[side])))
        wrist_deg = np.stack(
            [_wave(time_s, -50, 60, 0.3, phase), _wave(time_s, -20, 25, 0.5, phase), _wave(time_s, -15, 15, 0.4, 0.0)],
            axis=-1,
        )
        turn(f"{side}Hand", Rotation.from_euler("xyz", wrist_deg, degrees=True))
        turn(f"{side}Leg", Rotation.from_rotvec(np.full((num_frames, 1), 0.1) * np.array(KNEE_HINGE)))
        numbers, rotations = joint_rotations(SIDES[number], hinge_angles_rad(num_frames, phase))
        for joint, rotation in zip(numbers.tolist(), rotations, strict=True):
            quat[:, joint] = rotation.as_quat()
    root_m = np.stack([0.05 * np.sin(time_s), 0.05 * np.cos(time_s), np.full(num_frames, 0.93)], axis=-1)
    return SkeletonMotion(1, "person-1", 0, RATE_HZ, lengths_m, root_m, quat, ())


def landmarks_of(motion: SkeletonMotion) -> np.ndarray:
    """World positions of the joints of ``WHOLE_BODY``, (frames, joints, 3)."""
    posed_m = forward_kinematics(motion)
    points = {
        joint.landmarks[0]: posed_m[:, number]
        for number, joint in enumerate(WHOLE_SKELETON)
        if len(joint.landmarks) == 1
    }
    upright = {name: np.array(offset_m) for name, offset_m in _HEAD_M.items()}
    points |= {name: posed_m[:, INDEX["Head"]] + offset_m for name, offset_m in upright.items()}
    for side in SIDES:
        shin = Rotation.from_quat(motion.parent_from_joint[:, INDEX[f"{side.capitalize()}Leg"]])
        for name, offset_m in _FOOT_M.items():
            points[f"{side}_{name}"] = points[f"{side}_ankle"] + shin.apply(offset_m)
    return np.stack([points[name] for name in WHOLE_BODY.names], axis=1)
