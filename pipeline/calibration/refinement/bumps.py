"""Bumps: a camera that was moved in the middle of a take.

For each second of the take, the pan and tilt of a camera are computed that fit its sightings best, from the points
that the other cameras triangulate. A bump is a step of these angles.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from pipeline.calibration.adjustment.parameters import linearise
from pipeline.calibration.refinement.sightings import JointSightings
from pipeline.core.data.cameras import Camera

# Rotations about the camera's x and y axes. Roll is hardly determined by the people of one second.
_PAN_AND_TILT = slice(0, 2)
_BLOCK_S = 1.0
_MIN_POINTS = 12
# Blocks before and after a step that are compared.
_WINDOW = 3
# Least step, also as a multiple of the median change between neighbouring windows: people who move turn a camera that
# is slightly off to and fro.
_MIN_STEP_RAD = np.radians(0.4)
_MIN_RATIO = 3.0


class Step(NamedTuple):
    """Step of a camera's orientation."""

    camera: int  # Position of the camera
    time_s: float  # Time of the step on the session's clock
    turn_rad: float  # Angle of the step

    def hidden(self, sightings: JointSightings) -> Bool[np.ndarray, "points cameras"]:
        """Views of the camera on the side of the step that has fewer of them."""
        hidden = np.zeros(sightings.points_px.shape[:2], bool)
        is_after = sightings.time_s >= self.time_s
        is_seen = np.isfinite(sightings.points_px[:, self.camera]).all(-1)
        has_less_after = (is_seen & is_after).sum() <= (is_seen & ~is_after).sum()
        hidden[:, self.camera] = is_after if has_less_after else ~is_after
        return hidden


def find_steps(cameras: Sequence[Camera], sightings: JointSightings) -> list[Step]:
    """Find the largest step of each camera's orientation; none with fewer than three cameras.

    A camera that was moved makes the others seem to move as well: not all of the steps are true. The cameras must fit
    the take on the whole.
    """
    if len(cameras) < 3:
        return []
    steps = (_find_step(camera, cameras, sightings) for camera in range(len(cameras)))
    return [step for step in steps if step is not None]


def _find_step(number: int, cameras: Sequence[Camera], sightings: JointSightings) -> Step | None:
    others_px = sightings.points_px.copy()
    others_px[:, number] = np.nan
    xyz_m = replace(sightings, points_px=others_px).triangulated(cameras)
    projected_px, by_camera, _ = linearise(cameras[number], xyz_m)
    residual_px = sightings.points_px[:, number] - projected_px
    used = np.isfinite(residual_px).all(-1)
    time_s, residual_px, by_turn = sightings.time_s[used], residual_px[used], by_camera[used][:, :, _PAN_AND_TILT]
    block = np.floor((time_s - sightings.time_s.min()) / _BLOCK_S).astype(int) if len(time_s) else np.zeros(0, int)
    numbers = np.flatnonzero(np.bincount(block, minlength=1) >= _MIN_POINTS)
    if len(numbers) < 2 * _WINDOW:
        return None
    turns = np.array([_fit_turn(by_turn[block == k], residual_px[block == k]) for k in numbers])
    cuts = np.arange(_WINDOW, len(turns) - _WINDOW + 1)
    before, after = (
        np.array([np.median(turns[cut + shift : cut + shift + _WINDOW], axis=0) for cut in cuts])
        for shift in (-_WINDOW, 0)
    )
    change_rad = np.linalg.norm(after - before, axis=-1)
    best = int(np.argmax(change_rad))
    if change_rad[best] < max(_MIN_STEP_RAD, _MIN_RATIO * float(np.median(change_rad))):
        return None
    cut = cuts[best]
    turn_rad = float(np.linalg.norm(np.median(turns[cut:], axis=0) - np.median(turns[:cut], axis=0)))
    near = np.abs(block - (numbers[cut - 1] + numbers[cut]) / 2) <= 1.0 + (numbers[cut] - numbers[cut - 1]) / 2
    return Step(
        number, _time_of_step(time_s[near], residual_px[near], by_turn[near], before[best], after[best]), turn_rad
    )


def _fit_turn(
    by_turn: Float[np.ndarray, "points 2 2"], residual_px: Float[np.ndarray, "points 2"]
) -> Float[np.ndarray, " 2"]:
    """Turn that explains residuals: least absolute distances, by reweighting."""
    turn = np.zeros(2)
    for _ in range(10):
        left_px = np.linalg.norm(residual_px - by_turn @ turn, axis=-1)
        weight = 1.0 / np.maximum(left_px, 0.5)
        normal = np.einsum("p,pia,pib->ab", weight, by_turn, by_turn)
        turn = np.linalg.solve(
            normal + 1e-9 * np.trace(normal) * np.eye(2), np.einsum("p,pia,pi->a", weight, by_turn, residual_px)
        )
    return turn


def _time_of_step(
    time_s: Float[np.ndarray, " points"],
    residual_px: Float[np.ndarray, "points 2"],
    by_turn: Float[np.ndarray, "points 2 2"],
    before: Float[np.ndarray, " 2"],
    after: Float[np.ndarray, " 2"],
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
