"""Motion of the fingers of simulated people: postures that follow each other, with natural rest between them."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter1d

from pipeline.validation.simulation.motion.gestures import smooth_noise
from pipeline.validation.simulation.motion.hands import ANGLES, LIMITS_RAD
from pipeline.validation.simulation.motion.locomotion import GRID_HZ
from pipeline.validation.simulation.motion.script import Cue, Gesture, Stay

_STRAIGHT, _BENT = (0.0, 6.0), (80.0, 92.0)
_FINGERS = ("index", "middle", "ring", "pinky")
_THUMB_OUT, _THUMB_ACROSS = (48.0, 12.0, 5.0, 5.0), (22.0, 42.0, 42.0, 48.0)


def _posture(
    bends_deg: Sequence[tuple[float, float]],
    spread_deg: Sequence[float],
    thumb_deg: tuple[float, float, float, float],
    wrist_deg: tuple[float, float, float] = (15.0, -10.0, 0.0),
) -> Float[np.ndarray, " 19"]:
    """Angles of a posture, as in ``ANGLES``; bends are those of the knuckle and of the hinge after it."""
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
                _gesticulate(angles_rad[:, hand], cue.gesture, rows, rng)
    angles_rad = gaussian_filter1d(angles_rad, _CHANGE_S * GRID_HZ, axis=0, mode="nearest")
    time_s = np.arange(num_rows) / GRID_HZ
    angles_rad += _TREMBLE_RAD * smooth_noise(time_s, angles_rad.shape[1:], 0.1, 0.8, rng)
    return np.clip(angles_rad, *LIMITS_RAD.T)


def _gesticulate(
    angles_rad: Float[np.ndarray, "times 19"], gesture: Gesture, rows: slice, rng: np.random.Generator
) -> None:
    """Write the postures of a gesture to the rows of one hand."""
    postures = _OF_GESTURE[gesture]
    start = rows.start
    while start < rows.stop:
        posture = postures[rng.integers(len(postures))].copy()
        stop = rows.stop
        if gesture in _CHANGING:
            posture[:3] += rng.uniform(-_WRIST_RAD, _WRIST_RAD)
            stop = min(stop, start + round(rng.uniform(*_HOLD_S) * GRID_HZ))
        angles_rad[start:stop] = posture
        start = stop + round(rng.uniform(*_REST_S) * GRID_HZ)
