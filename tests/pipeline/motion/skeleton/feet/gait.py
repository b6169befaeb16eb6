"""Walk in closed form whose heels and toes truly stand: heel strike, foot flat, toe off."""

from dataclasses import dataclass

import numpy as np

from pipeline.core.joints import BODY_FEET, COCO_17
from tests.pipeline.motion.skeleton.synthetic_tracks import walker

RATE_HZ = 30.0
STRIDE_S, STRIDE_M = 1.1, 1.2
# Times since heel strike: the foot is flat, the heel leaves the floor, the toe leaves it.
FLAT_S, HEEL_OFF_S, TOE_OFF_S = 0.12, 0.42, 0.66
TOES_UP_RAD, TOES_DOWN_RAD = np.radians(-20.0), np.radians(40.0)
HEEL_M, TOE_M = np.array([0.0, 0.055, -0.075]), np.array([-0.02, -0.16, -0.08])
_THIGH_M, _SHIN_M, _HIP_HEIGHT_M = 0.46, 0.46, 0.88


@dataclass(frozen=True)
class Gait:
    """Truth of a walk towards -Y.

    Parameters
    ----------
    xyz_m
        Joints of ``BODY_FEET``.
    pitch_rad
        Rotation of each foot (left, right) about X; toes down are positive.
    stands
        Whether heel and toe of each foot stand, (frames, feet, heel and toe).
    """

    xyz_m: np.ndarray
    pitch_rad: np.ndarray
    stands: np.ndarray


def _smooth(share: np.ndarray) -> np.ndarray:
    share = np.clip(share, 0.0, 1.0)
    return np.asarray(share * share * (3.0 - 2.0 * share))


def _turned(pitch_rad: np.ndarray, offset_m: np.ndarray) -> np.ndarray:
    sine, cosine = np.sin(pitch_rad), np.cos(pitch_rad)
    y, z = offset_m[1], offset_m[2]
    return np.stack([np.full_like(sine, offset_m[0]), cosine * y - sine * z, sine * y + cosine * z], axis=-1)


def _pitch_rad(since_s: np.ndarray) -> np.ndarray:
    strike = TOES_UP_RAD * (1 - _smooth(since_s / FLAT_S))
    off = TOES_DOWN_RAD * _smooth((since_s - HEEL_OFF_S) / (TOE_OFF_S - HEEL_OFF_S))
    swing = (TOES_UP_RAD - TOES_DOWN_RAD) * _smooth((since_s - TOE_OFF_S) / (STRIDE_S - TOE_OFF_S))
    return np.asarray(strike + off + swing)


def _ankle_m(since_s: np.ndarray, start_m: np.ndarray, heel_m: np.ndarray, toe_m: np.ndarray) -> np.ndarray:
    """Ankle of a foot whose flat position in this step is at ``start_m``."""
    pitch_rad = _pitch_rad(since_s)
    on_heel = start_m + heel_m - _turned(pitch_rad, heel_m)
    on_toe = start_m + toe_m - _turned(pitch_rad, toe_m)
    return np.where((since_s < HEEL_OFF_S)[:, None], on_heel, on_toe)


def gait(num_frames: int) -> Gait:
    """Walk of a person of the given number of frames, at 30 frames a second."""
    time_s = np.arange(num_frames) / RATE_HZ
    centre_m = np.stack([np.zeros(num_frames), 1.6 - time_s * STRIDE_M / STRIDE_S, np.zeros(num_frames)], axis=-1)
    coco_m = np.repeat(walker(1), num_frames, axis=0)
    hips = COCO_17.indices(("left_hip", "right_hip"))
    middle_m = coco_m[:, hips].mean(1, keepdims=True)
    coco_m += centre_m[:, None] + [0.0, 0.0, _HIP_HEIGHT_M] - middle_m
    points = {name: coco_m[:, number] for number, name in enumerate(COCO_17.names)}
    pitch_rad, stands = np.empty((num_frames, 2)), np.empty((num_frames, 2, 2), bool)
    for foot, (side, sign) in enumerate((("left", 1.0), ("right", -1.0))):
        number, since_s = np.divmod(time_s + foot * STRIDE_S / 2, STRIDE_S)
        pitch_rad[:, foot] = _pitch_rad(since_s)
        stands[:, foot, 0] = since_s < HEEL_OFF_S
        stands[:, foot, 1] = (since_s >= FLAT_S) & (since_s < TOE_OFF_S)
        heel_m, toe_m = HEEL_M * [sign, 1.0, 1.0], TOE_M * [sign, 1.0, 1.0]
        here_m = np.zeros((num_frames, 3))
        # The flat foot is below the hips in the middle of its stance.
        middle_s = number * STRIDE_S + TOE_OFF_S / 2 - foot * STRIDE_S / 2
        here_m[:, 0], here_m[:, 1] = 0.1 * sign, 1.6 - middle_s * STRIDE_M / STRIDE_S
        here_m[:, 2] = -HEEL_M[2] + 0.02
        ankle_m = _ankle_m(since_s, here_m, heel_m, toe_m)
        # In the air, from the end of this stance to the start of the next.
        left_m = _ankle_m(np.full(num_frames, TOE_OFF_S), here_m, heel_m, toe_m)
        next_m = _ankle_m(np.zeros(num_frames), here_m - [0.0, STRIDE_M, 0.0], heel_m, toe_m)
        share = _smooth((since_s - TOE_OFF_S) / (STRIDE_S - TOE_OFF_S))[:, None]
        lift_m = 0.08 * np.sin(np.pi * share) ** 2 * [0.0, 0.0, 1.0]
        ankle_m = np.where((since_s < TOE_OFF_S)[:, None], ankle_m, left_m + share * (next_m - left_m) + lift_m)
        points[f"{side}_ankle"] = ankle_m
        points[f"{side}_heel"] = ankle_m + _turned(pitch_rad[:, foot], heel_m)
        points[f"{side}_big_toe"] = ankle_m + _turned(pitch_rad[:, foot], toe_m)
        points[f"{side}_knee"] = _knee_m(points[f"{side}_hip"], ankle_m)
    return Gait(np.stack([points[name] for name in BODY_FEET.names], axis=1), pitch_rad, stands)


def _knee_m(hip_m: np.ndarray, ankle_m: np.ndarray) -> np.ndarray:
    """Knee of a leg that bends forwards."""
    along_m = ankle_m - hip_m
    distance_m = np.linalg.norm(along_m, axis=-1, keepdims=True)
    along = along_m / distance_m
    ahead = np.array([0.0, -1.0, 0.0]) - (along @ [0.0, -1.0, 0.0])[:, None] * along
    ahead /= np.linalg.norm(ahead, axis=-1, keepdims=True)
    down_m = (distance_m**2 + _THIGH_M**2 - _SHIN_M**2) / (2 * distance_m)
    return np.asarray(hip_m + down_m * along + np.sqrt(np.maximum(_THIGH_M**2 - down_m**2, 0.0)) * ahead)
