"""Turns that bring the pictures of cameras upright: by the calibration, checked by the people in a few frames.

Networks learnt from upright people. They tolerate a camera that leans a little; of a picture that is turned by a
quarter they find half of the joints (docs/lab/detection.md). The calibration tells how a camera hangs, if its world
has Z up. People are stronger evidence: they are found with more confidence in an upright picture, and their trunks
point up in it.
"""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from pipeline.core.data.cameras import Camera
from pipeline.core.data.turns import turned_axes
from pipeline.core.joints import JointSet
from pipeline.detection.bodies import ImageBodies

TOLERATED_DEG = 30.0
"""Largest roll of a camera whose pictures are left as they are, and largest rest that a quarter turn leaves."""
# Least angle between the view and the vertical with which the picture has an up: people seen from above lie in any
# direction.
_LEAST_FROM_VERTICAL_DEG = 25.0
_QUARTERS_DEG = (0.0, 90.0, 180.0, 270.0)
# Joints that count, and the share of the bodies, weighted by their confidence, whose trunks point up in an upright
# picture. Measured in 12 cameras: 0.76 to 1.0 in upright pictures, at most 0.35 in those turned by quarters.
_MIN_SCORE, _UPRIGHT_DEG, _MIN_UPRIGHT_SHARE = 0.2, 45.0, 0.6
# Another turn is taken if the confidence in it is so much higher. Upright pictures had 1.2 to 1.8 times the confidence
# of quarter turns.
_CLEARLY_MORE = 1.1
# A known turn with so much more confidence than the picture as it is needs no further look. Networks that do not show
# how people lean had at most a fifth in quarter turns.
_FAR_MORE = 2.0

NumberedBodies = Sequence[tuple[int, ImageBodies]]
"""Bodies in frames, with the frames' numbers."""
LookAt = Callable[[float], NumberedBodies]
"""Function that detects the bodies in the frames to look at, turned counterclockwise by an angle in degrees."""


def turn_of_roll(camera: Camera) -> float | None:
    """Turn that brings the pictures of a camera upright, if Z is up in its world.

    It is counterclockwise, in degrees from 0 to 360: 0 for a camera that leans by at most 30 degrees, a quarter turn
    for a camera that is as near to it, and to the degree for others. Up is the direction of the vertical in the middle
    of the picture. ``None`` for a camera that looks up or down so steeply that the picture has no up.
    """
    width, height = camera.size_px
    ray = np.linalg.solve(camera.matrix, [(width - 1) / 2, (height - 1) / 2, 1.0])
    up = camera.cam_from_world.rotation[:, 2]
    if np.linalg.norm(np.cross(ray, up)) < np.sin(np.radians(_LEAST_FROM_VERTICAL_DEG)) * np.linalg.norm(ray):
        return None
    # The derivative of the projection along the vertical.
    x, y = camera.matrix[:2, :2] @ (up[:2] - up[2] * ray[:2])
    return _settled(float(np.degrees(np.arctan2(x, -y))))


def find_turn(
    known_deg: float | None, joints: JointSet, look_at: LookAt, shows_lean: bool
) -> tuple[float, NumberedBodies]:
    """Find the turn that brings the pictures of a camera upright, and the bodies in the turned frames.

    - ``known_deg``: turn by the calibration, see ``turn_of_roll``; ``None`` if it is not known. A camera that is
      upright by its calibration is taken as it is. Any other turn is only the first to be tried: the world may not be
      level.
    - ``joints``: joints of the bodies.
    - ``look_at``: function that detects the bodies; called once for each turn that is tried.
    - ``shows_lean``: whether the detector finds people in any turn, and so shows how they lean. Then a turn in which
      they are upright ends the search, and how they lean tells which turn to try next.
    - Returns the turn in which people are upright. If there is none, and without ``shows_lean``, the turn with the most
      confidence; the first one unless another has clearly more.
    """
    first_deg = known_deg or 0.0
    looks = {first_deg: look_at(first_deg)}
    least = _CLEARLY_MORE * _confidence(looks[first_deg])
    if known_deg == 0.0 or (shows_lean and _is_upright(looks[first_deg], first_deg, joints)):
        return first_deg, looks[first_deg]
    next_deg = 0.0
    if shows_lean:
        next_deg = 90.0 * round((first_deg + _lean_deg(looks[first_deg], first_deg, joints)) / 90.0) % 360.0
    for turn_deg in (next_deg, *_QUARTERS_DEG):
        if turn_deg not in looks:
            looks[turn_deg] = bodies = look_at(turn_deg)
            if shows_lean and _confidence(bodies) > least and _is_upright(bodies, turn_deg, joints):
                return turn_deg, bodies
            is_far_less = _FAR_MORE * _confidence(bodies) < _confidence(looks[first_deg])
            if known_deg is not None and turn_deg == 0.0 and is_far_less:
                break
    best_deg = max(looks, key=lambda turn_deg: _confidence(looks[turn_deg]))
    chosen_deg = best_deg if _confidence(looks[best_deg]) > least else first_deg
    return chosen_deg, looks[chosen_deg]


def _settled(turn_deg: float) -> float:
    """Quarter turn if it is near enough, else the turn to the degree; from 0 to 360."""
    quarter_deg = 90.0 * round(turn_deg / 90.0)
    is_near = abs(turn_deg - quarter_deg) <= TOLERATED_DEG
    return (quarter_deg if is_near else float(round(turn_deg))) % 360.0


def _confidence(bodies: NumberedBodies) -> float:
    """Sum of the scores of all joints that count."""
    return float(sum(_weights(image).sum() for _, image in bodies))


def _weights(bodies: ImageBodies) -> Float[np.ndarray, " n"]:
    return np.where(bodies.score >= _MIN_SCORE, bodies.score, 0.0).sum(1)


def _is_upright(bodies: NumberedBodies, turn_deg: float, joints: JointSet) -> bool:
    """Test for trunks of bodies that point up in the turned frames."""
    angle_deg, weight = _trunks(bodies, turn_deg, joints)
    return bool(weight[np.abs(angle_deg) <= _UPRIGHT_DEG].sum() >= _MIN_UPRIGHT_SHARE * weight.sum() > 0.0)


def _lean_deg(bodies: NumberedBodies, turn_deg: float, joints: JointSet) -> float:
    """Mean direction of the trunks in the turned frames, clockwise from up; 0 without bodies."""
    angle_deg, weight = _trunks(bodies, turn_deg, joints)
    return float(np.degrees(np.angle((weight * np.exp(1j * np.radians(angle_deg))).sum())))


def _trunks(
    bodies: NumberedBodies, turn_deg: float, joints: JointSet
) -> tuple[Float[np.ndarray, " trunks"], Float[np.ndarray, " trunks"]]:
    """Directions of trunks in degrees, clockwise from up in the turned frames, and the confidence in the bodies."""
    angles, weights = [np.zeros(0)], [np.zeros(0)]
    for _, image in bodies:
        shoulders_px, hips_px = (
            _middle_px(image, joints.indices((f"left_{kind}", f"right_{kind}"))) for kind in ("shoulder", "hip")
        )
        trunk_px = (shoulders_px - hips_px) @ turned_axes(turn_deg)
        known = np.isfinite(trunk_px).all(-1)
        angles.append(np.degrees(np.arctan2(trunk_px[known, 0], -trunk_px[known, 1])))
        weights.append(_weights(image)[known])
    return np.concatenate(angles), np.concatenate(weights)


def _middle_px(bodies: ImageBodies, pair: Sequence[int]) -> Float[np.ndarray, "n 2"]:
    """Mean of the joints of a pair that count; NaN without any."""
    counts = bodies.score[:, list(pair)] >= _MIN_SCORE
    total_px = np.where(counts[..., None], bodies.keypoints_px[:, list(pair)], 0.0).sum(1)
    return total_px / np.where(counts.any(1), counts.sum(1), np.nan)[:, None]
