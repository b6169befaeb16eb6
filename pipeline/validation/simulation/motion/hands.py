"""Hands of simulated people: fingers of constant length as chains of hinges on the palm.

The axes of a hand are distal (from the wrist along the palm), radial (to the side of the thumb) and palmar (out of the
palm); postures of the right hand are the mirror image of the left hand's. A finger bends about an axis that is fixed in
the palm; its knuckle also spreads. The thumb's metacarpal has two angles, and its other joints bend to the little
finger and to the palm.

Lengths are means of adults (Buryanov and Kotiuk 2010, proportions of hand segments), with the soft tissue of the tips.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter1d

from pipeline.validation.simulation.motion.body import Proportions
from pipeline.validation.simulation.motion.gestures import smooth_noise
from pipeline.validation.simulation.motion.locomotion import GRID_HZ
from pipeline.validation.simulation.motion.script import Cue, Gesture, Stay

ANGLES = (
    "pronation", "wrist_flexion", "wrist_deviation",
    *(f"{finger}_{angle}" for finger in ("index", "middle", "ring", "pinky") for angle in ("mcp", "spread", "pip")),
    "thumb_radial", "thumb_palmar", "thumb_mcp", "thumb_ip",
)  # fmt: skip
"""Angles of a hand: rotation of the forearm with the palm down, bends to the palm, and abductions to the thumb."""

_LIMITS_DEG = {
    "pronation": (-80.0, 80.0),
    "wrist_flexion": (-60.0, 70.0),
    "wrist_deviation": (-30.0, 20.0),
    "mcp": (-15.0, 90.0),
    "spread": (-18.0, 18.0),
    "pip": (0.0, 105.0),
    "thumb_radial": (10.0, 60.0),
    "thumb_palmar": (0.0, 50.0),
    "thumb_mcp": (0.0, 55.0),
    "thumb_ip": (0.0, 75.0),
}
LIMITS_RAD = np.radians([_LIMITS_DEG.get(name) or _LIMITS_DEG[name.rpartition("_")[2]] for name in ANGLES])
"""Smallest and largest value of each angle, within the ranges of the American Academy of Orthopaedic Surgeons."""

DIP_SHARE = 0.67
"""Bend of a finger's last joint as a share of the bend of the joint before it: both are moved by one tendon."""

# Hand of a person of mean stature, in metres: knuckles from the wrist (distal, radial, palmar), and phalanges.
_MEAN_STATURE_M = 1.72
_KNUCKLES_M = np.array(
    [[0.090, 0.022, 0.0], [0.092, 0.001, -0.003], [0.085, -0.018, 0.0], [0.077, -0.035, 0.004]]
)  # fmt: skip
_PHALANGES_M = np.array([[0.040, 0.022, 0.019], [0.045, 0.026, 0.021], [0.041, 0.026, 0.021], [0.033, 0.018, 0.019]])
_THUMB_BASE_M = np.array([0.026, 0.022, 0.010])
_THUMB_M = np.array([0.046, 0.032, 0.025])
# Direction in which the thumb bends: to the little finger and to the palm.
_THUMB_BEND = np.array([0.0, -0.8, 0.6])
_SIDES = np.array([1.0, -1.0])


@dataclass(frozen=True, slots=True, eq=False)
class Hands:
    """Size and motion of a person's hands."""

    scale: float  # Size relative to the mean hand of adults
    angles_rad: Float[np.ndarray, "times 2 19"]  # ``ANGLES`` of the left and of the right hand


def random_scale(body: Proportions, rng: np.random.Generator) -> float:
    """Draw the size of a person's hands: the stature's within a few percent."""
    return float(body.stature_m / _MEAN_STATURE_M * np.clip(rng.normal(1.0, 0.03), 0.92, 1.08))


def fingers(
    hands: Hands,
    shoulders_m: Float[np.ndarray, "times 2 3"],
    elbows_m: Float[np.ndarray, "times 2 3"],
    wrists_m: Float[np.ndarray, "times 2 3"],
) -> Float[np.ndarray, "times 40 3"]:
    """World positions of the fingers' joints: ``finger_joints("left")``, then the right hand's."""
    axes = _palms(shoulders_m, elbows_m, wrists_m, hands.angles_rad[..., :3])
    chains = [_thumb(hands.angles_rad[..., 15:])]
    chains += [_finger(number, hands.angles_rad[..., 3 * number + 3 : 3 * number + 6]) for number in range(4)]
    in_hand = hands.scale * np.concatenate(chains, axis=-2)
    points_m = wrists_m[:, :, None] + np.einsum("tsja,tsab->tsjb", in_hand, axes)
    return points_m.reshape(len(points_m), -1, 3)


def _palms(
    shoulders_m: np.ndarray, elbows_m: np.ndarray, wrists_m: np.ndarray, angles_rad: Float[np.ndarray, "times 2 3"]
) -> Float[np.ndarray, "times 2 3 3"]:
    """World directions of the distal, radial and palmar axes of both hands.

    A neutral forearm turns the palm inwards along the axis of the elbow.
    """
    distal = _unit(wrists_m - elbows_m)
    palmar = _SIDES[:, None] * _unit(np.cross(elbows_m - shoulders_m, wrists_m - elbows_m))
    pronation, flexion, deviation = np.moveaxis(angles_rad[..., None], -2, 0)
    radial = _SIDES[:, None] * np.cross(palmar, distal)
    # A palm that faces inwards turns down: to the side opposite to the thumb.
    palmar, ulnar = _turn(palmar, -radial, pronation)
    distal, palmar = _turn(distal, palmar, flexion)
    distal, radial = _turn(distal, -ulnar, deviation)
    return np.stack([distal, radial, palmar], axis=-2)


def _turn(first: np.ndarray, second: np.ndarray, angle_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Turn two orthogonal directions in their plane, the first towards the second."""
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    return cos * first + sin * second, cos * second - sin * first


def _finger(number: int, angles_rad: Float[np.ndarray, "times 2 3"]) -> Float[np.ndarray, "times 2 4 3"]:
    """Joints of a finger in the axes of the palm: knuckle, two hinges and tip."""
    mcp, spread, pip = np.moveaxis(angles_rad, -1, 0)
    ahead = np.stack([np.cos(spread), np.sin(spread), np.zeros_like(spread)], axis=-1)
    bends = np.cumsum(np.stack([mcp, pip, DIP_SHARE * pip], axis=-1), axis=-1)
    return _chain(_KNUCKLES_M[number], _PHALANGES_M[number], ahead, np.array([0.0, 0.0, 1.0]), bends)


def _thumb(angles_rad: Float[np.ndarray, "times 2 4"]) -> Float[np.ndarray, "times 2 4 3"]:
    """Joints of the thumb in the axes of the palm: base, two hinges and tip."""
    aside, raised, mcp, ip = np.moveaxis(angles_rad, -1, 0)
    level = np.stack([np.cos(aside), np.sin(aside), np.zeros_like(aside)], axis=-1)
    ahead = np.cos(raised)[..., None] * level + np.sin(raised)[..., None] * np.array([0.0, 0.0, 1.0])
    inwards = _unit(_THUMB_BEND - (ahead @ _THUMB_BEND)[..., None] * ahead)
    bends = np.cumsum(np.stack([np.zeros_like(mcp), mcp, ip], axis=-1), axis=-1)
    return _chain(_THUMB_BASE_M, _THUMB_M, ahead, inwards, bends)


def _chain(
    base_m: Float[np.ndarray, " 3"],
    lengths_m: Float[np.ndarray, " 3"],
    ahead: Float[np.ndarray, "times 2 3"],
    inwards: np.ndarray,
    bends_rad: Float[np.ndarray, "times 2 3"],
) -> Float[np.ndarray, "times 2 4 3"]:
    """Joints of a chain whose segments are turned from one direction towards an orthogonal one."""
    turned = bends_rad[..., None]
    segments_m = lengths_m[:, None] * (np.cos(turned) * ahead[..., None, :] + np.sin(turned) * inwards[..., None, :])
    start_m = np.broadcast_to(base_m, (*segments_m.shape[:-2], 1, 3))
    return np.concatenate([start_m, base_m + np.cumsum(segments_m, axis=-2)], axis=-2)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


_STRAIGHT, _BENT = (0.0, 6.0), (80.0, 92.0)
_FINGERS = ("index", "middle", "ring", "pinky")
_THUMB_OUT, _THUMB_ACROSS = (48.0, 12.0, 5.0, 5.0), (22.0, 42.0, 42.0, 48.0)


def _posture(
    bends_deg: Sequence[tuple[float, float]],
    spread_deg: Sequence[float],
    thumb_deg: tuple[float, float, float, float],
    wrist_deg: tuple[float, float, float] = (15.0, -10.0, 0.0),
) -> Float[np.ndarray, " 19"]:
    """Angles of a posture, as in ``ANGLES``; bends are of the knuckle and of the hinge after it."""
    angles = dict(zip(("pronation", "wrist_flexion", "wrist_deviation"), wrist_deg, strict=True))
    for finger, (mcp, pip), spread in zip(_FINGERS, bends_deg, spread_deg, strict=True):
        angles |= {f"{finger}_mcp": mcp, f"{finger}_spread": spread, f"{finger}_pip": pip}
    thumb = ("thumb_radial", "thumb_palmar", "thumb_mcp", "thumb_ip")
    return np.radians([(angles | dict(zip(thumb, thumb_deg, strict=True)))[name] for name in ANGLES])


_TOGETHER, _APART = (3.0, 0.0, -2.0, -5.0), (12.0, 2.0, -6.0, -14.0)
REST = _posture(((22.0, 28.0), (26.0, 32.0), (29.0, 35.0), (32.0, 36.0)), _TOGETHER, (32.0, 24.0, 15.0, 18.0))
"""Natural rest: slightly bent, more so to the little finger."""
_OPEN = _posture((_STRAIGHT,) * 4, _APART, _THUMB_OUT)
_FLAT = _posture((_STRAIGHT,) * 4, _TOGETHER, (30.0, 10.0, 5.0, 5.0))
_FIST = _posture((_BENT,) * 4, (0.0, 0.0, 0.0, 0.0), _THUMB_ACROSS)
_POINTING = _posture((_STRAIGHT, _BENT, _BENT, _BENT), (2.0, 0.0, 0.0, 0.0), _THUMB_ACROSS)
_PINCH = _posture(
    ((46.0, 52.0), (30.0, 30.0), (22.0, 24.0), (16.0, 20.0)), (0.0, 0.0, -4.0, -10.0), (26.0, 46.0, 22.0, 30.0)
)
_GRIP = _posture(
    ((38.0, 42.0), (40.0, 45.0), (42.0, 48.0), (44.0, 48.0)), _TOGETHER, (45.0, 30.0, 15.0, 15.0), (0.0, -15.0, 0.0)
)
_TWO = _posture((_STRAIGHT, _STRAIGHT, _BENT, _BENT), (10.0, -6.0, 0.0, 0.0), _THUMB_ACROSS)
_THREE = _posture((_STRAIGHT, _STRAIGHT, _STRAIGHT, _BENT), (11.0, 0.0, -11.0, 0.0), _THUMB_ACROSS)
_FOUR = _posture((_STRAIGHT,) * 4, _APART, _THUMB_ACROSS)

_ALL = (_OPEN, _FIST, _POINTING, _PINCH, _TWO, _THREE, _FOUR, _FLAT, _GRIP)
_OF_GESTURE: Mapping[Gesture, tuple[np.ndarray, ...]] = {
    Gesture.WAVE: (_OPEN,),
    Gesture.POINT: (_POINTING,),
    Gesture.TALK: (_OPEN, _PINCH, _FLAT),
    Gesture.SHAKE_HANDS: (_GRIP,),
    Gesture.CLAP: (_FLAT,),
    Gesture.HUG: (_FLAT,),
    Gesture.PUNCH: (_FIST,),
    Gesture.SWING: (_FIST,),
    Gesture.JUMP: (_FLAT, _FIST),
    Gesture.COUNTERMOVEMENT_JUMP: (_FLAT, _FIST),
    Gesture.HANDS: _ALL,
}
# Gestures whose fingers come to rest between two postures, and duration of a posture and of a rest.
_CHANGING = (Gesture.TALK, Gesture.HANDS)
_HOLD_S, _REST_S = (0.6, 1.3), (0.3, 0.7)
# Range of the turns of the wrist for the hands of a gesture with many postures, beside the posture's own angles.
_WRIST_RAD = np.radians([45.0, 25.0, 10.0])
# Standard deviation of the smoothing of changes, which take about two and a half times as long.
_CHANGE_S = 0.11
_TREMBLE_RAD = np.radians(2.0)


def finger_motion(
    cues: Sequence[Cue], cue_rows: Sequence[slice], num_rows: int, rng: np.random.Generator
) -> Float[np.ndarray, "times 2 19"]:
    """Angles of both hands on the grid of ``GRID_HZ``, within their limits.

    ``cue_rows`` are the rows of each cue; cues later than ``num_rows`` are cut off.
    """
    angles_rad = np.tile(REST, (num_rows, 2, 1))
    for cue, rows in zip(cues, cue_rows, strict=True):
        if isinstance(cue, Stay) and cue.gesture in _OF_GESTURE:
            for hand in (0, 1):
                postures = _OF_GESTURE[cue.gesture]
                start = rows.start
                while start < rows.stop:
                    posture = postures[rng.integers(len(postures))].copy()
                    stop = rows.stop
                    if cue.gesture in _CHANGING:
                        posture[:3] += rng.uniform(-_WRIST_RAD, _WRIST_RAD)
                        stop = min(stop, start + round(rng.uniform(*_HOLD_S) * GRID_HZ))
                    angles_rad[:, hand][start:stop] = posture
                    start = stop + round(rng.uniform(*_REST_S) * GRID_HZ)
    angles_rad = gaussian_filter1d(angles_rad, _CHANGE_S * GRID_HZ, axis=0, mode="nearest")
    time_s = np.arange(num_rows) / GRID_HZ
    angles_rad += _TREMBLE_RAD * smooth_noise(time_s, angles_rad.shape[1:], 0.1, 0.8, rng)
    return np.clip(angles_rad, *LIMITS_RAD.T)
