"""Bumps: a camera that was moved in the middle of a take.

For each second of the take, the turn of a camera is computed that fits its sightings best, from the points that the
other cameras triangulate. A bump is a step of these turns.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from pipeline.calibration.refinement.adjust import ROTATION, linearise, triangulate_sightings
from pipeline.calibration.refinement.sightings import Sightings
from pipeline.data import Camera

_BLOCK_S = 1.0
_MIN_POINTS = 12
# Blocks that a camera has to stay on either side of a step.
_MIN_BLOCKS = 3
_MIN_STEP_RAD = np.radians(0.4)
# Least step over the spread of the turns before and after it.
_MIN_RATIO = 4.0
_MAD_TO_SIGMA = 1.483


class Step(NamedTuple):
    """Step of a camera's orientation.

    Parameters
    ----------
    camera
        Position of the camera.
    time_s
        Time of the step on the session's clock.
    turn_rad
        Angle of the step.
    """

    camera: int
    time_s: float
    turn_rad: float

    def hidden(self, sightings: Sightings) -> Bool[np.ndarray, "points cameras"]:
        """Views of the camera on the side of the step that has fewer of them."""
        hidden = np.zeros(sightings.points_px.shape[:2], bool)
        is_after = sightings.time_s >= self.time_s
        is_seen = np.isfinite(sightings.points_px[:, self.camera]).all(-1)
        has_less_after = (is_seen & is_after).sum() <= (is_seen & ~is_after).sum()
        hidden[:, self.camera] = is_after if has_less_after else ~is_after
        return hidden


def find_step(cameras: Sequence[Camera], sightings: Sightings) -> Step | None:
    """Find the largest step of a camera's orientation; ``None`` if no camera was moved, or there are fewer than three.

    Parameters
    ----------
    cameras
        Cameras that fit most of the take.
    """
    if len(cameras) < 3:
        return None
    steps = [step for camera in range(len(cameras)) if (step := _step_of(camera, cameras, sightings)) is not None]
    return max(steps, key=lambda step: step.turn_rad, default=None)


def _step_of(number: int, cameras: Sequence[Camera], sightings: Sightings) -> Step | None:
    """Step of one camera."""
    by_others_px = sightings.points_px.copy()
    by_others_px[:, number] = np.nan
    xyz_m = triangulate_sightings(cameras, by_others_px)
    projected_px, by_camera, _ = linearise(cameras[number], xyz_m)
    residual_px = sightings.points_px[:, number] - projected_px
    used = np.isfinite(residual_px).all(-1)
    time_s, residual_px, by_turn = sightings.time_s[used], residual_px[used], by_camera[used][:, :, ROTATION]
    block = np.floor((time_s - sightings.time_s.min()) / _BLOCK_S).astype(int) if len(time_s) else np.zeros(0, int)
    numbers = np.flatnonzero(np.bincount(block, minlength=1) >= _MIN_POINTS)
    if len(numbers) < 2 * _MIN_BLOCKS:
        return None
    turns = np.array([_fit_turn(by_turn[block == k], residual_px[block == k]) for k in numbers])
    costs = [
        _deviation(turns[:k]).sum() + _deviation(turns[k:]).sum()
        for k in range(_MIN_BLOCKS, len(turns) - _MIN_BLOCKS + 1)
    ]
    cut = _MIN_BLOCKS + int(np.argmin(costs))
    before, after = np.median(turns[:cut], axis=0), np.median(turns[cut:], axis=0)
    turn_rad = float(np.linalg.norm(after - before))
    spread_rad = _MAD_TO_SIGMA * float(np.median(np.concatenate([_deviation(turns[:cut]), _deviation(turns[cut:])])))
    if turn_rad < max(_MIN_STEP_RAD, _MIN_RATIO * spread_rad):
        return None
    near = np.abs(block - (numbers[cut - 1] + numbers[cut]) / 2) <= 1.0 + (numbers[cut] - numbers[cut - 1]) / 2
    return Step(number, _time_of_step(time_s[near], residual_px[near], by_turn[near], before, after), turn_rad)


def _deviation(turns: Float[np.ndarray, "blocks 3"]) -> Float[np.ndarray, " blocks"]:
    return np.linalg.norm(turns - np.median(turns, axis=0), axis=-1)


def _fit_turn(
    by_turn: Float[np.ndarray, "points 2 3"], residual_px: Float[np.ndarray, "points 2"]
) -> Float[np.ndarray, " 3"]:
    """Turn that explains residuals: least absolute distances, by reweighting."""
    turn = np.zeros(3)
    for _ in range(10):
        left_px = np.linalg.norm(residual_px - by_turn @ turn, axis=-1)
        weight = 1.0 / np.maximum(left_px, 0.5)
        normal = np.einsum("p,pia,pib->ab", weight, by_turn, by_turn)
        turn = np.linalg.solve(
            normal + 1e-9 * np.trace(normal) * np.eye(3), np.einsum("p,pia,pi->a", weight, by_turn, residual_px)
        )
    return turn


def _time_of_step(
    time_s: Float[np.ndarray, " points"],
    residual_px: Float[np.ndarray, "points 2"],
    by_turn: Float[np.ndarray, "points 2 3"],
    before: Float[np.ndarray, " 3"],
    after: Float[np.ndarray, " 3"],
) -> float:
    """Time of the first sighting after the step: the one that splits the sightings with the least distance left."""
    gain_px = np.linalg.norm(residual_px - by_turn @ before, axis=-1) - np.linalg.norm(
        residual_px - by_turn @ after, axis=-1
    )
    times_s = np.unique(time_s)
    order = np.argsort(time_s, kind="stable")
    before_px = np.concatenate([[0.0], np.cumsum(gain_px[order])])
    starts = np.searchsorted(time_s[order], times_s)
    return float(times_s[np.argmin(before_px[starts])])
