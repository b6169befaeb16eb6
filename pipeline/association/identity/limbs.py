"""Limbs of a joint set that detectors exchange, and steady places of joints: medians over time with gaps filled."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import median_filter

from pipeline.core.joints import JointSet

_ARMS = ("shoulder", "elbow", "wrist")
_LEGS = ("hip", "knee", "ankle", "heel", "big_toe", "small_toe")


@dataclass(frozen=True, slots=True)
class LimbPair:
    """Both arms or both legs, as positions on the joint axis: joints from the trunk outwards, in the same order."""

    left: tuple[int, ...]
    right: tuple[int, ...]

    @property
    def both(self) -> list[int]:
        """Joints of the left limb, then of the right one."""
        return [*self.left, *self.right]

    @property
    def exchanged(self) -> list[int]:
        """Joints of the right limb, then of the left one."""
        return [*self.right, *self.left]


def arms_and_legs(joints: JointSet) -> tuple[LimbPair, LimbPair] | None:
    """Arms and legs of a joint set; ``None`` if it lacks a shoulder or a hip."""
    arms, legs = (_pair(joints, parts) for parts in (_ARMS, _LEGS))
    has_trunk = {f"{side}_{part}" for side in ("left", "right") for part in ("shoulder", "hip")} <= set(joints.names)
    return (arms, legs) if has_trunk else None


def _pair(joints: JointSet, parts: tuple[str, ...]) -> LimbPair:
    names = [part for part in parts if {f"left_{part}", f"right_{part}"} <= set(joints.names)]
    left, right = (tuple(joints.index(f"{side}_{name}") for name in names) for side in ("left", "right"))
    return LimbPair(left, right)


# Half of the time over which the median of a joint's places is taken: single frames of hard motion are wrong.
_STEADY_S = 0.1
# Longest time without a joint over which its place is expected between its neighbours in time.
_LONGEST_GAP_S = 1.0

REACH_S = _STEADY_S + _LONGEST_GAP_S / 2
"""Time on either side of a frame on which its steady place depends at most."""


def steady_places(
    xyz_m: Float[np.ndarray, "frames joints 3"], is_known: Bool[np.ndarray, "frames joints"], frame_rate_hz: float
) -> Float[np.ndarray, "frames joints 3"]:
    """Medians of joints' places over a fifth of a second, in metres; NaN where a joint is far from any known place.

    ``xyz_m`` may be anything where ``is_known`` is false.
    """
    rows = np.arange(len(xyz_m))
    filled_m = np.full(xyz_m.shape, np.nan)
    for joint in range(xyz_m.shape[1]):
        known = np.flatnonzero(is_known[:, joint])
        if len(known):
            for axis in range(3):
                filled_m[:, joint, axis] = np.interp(rows, known, xyz_m[known, joint, axis])
    size = 2 * round(_STEADY_S * frame_rate_hz) + 1
    steady_m = median_filter(np.nan_to_num(filled_m), size=(size, 1, 1), mode="nearest")
    return np.where(_near_in_time(is_known, _LONGEST_GAP_S * frame_rate_hz)[..., None], steady_m, np.nan)


def _near_in_time(is_known: Bool[np.ndarray, "frames joints"], longest_gap: float) -> Bool[np.ndarray, "frames joints"]:
    """Frames with a known place of a joint at most half a gap away on one side."""
    rows = np.arange(len(is_known))[:, None]
    before = np.maximum.accumulate(np.where(is_known, rows, -np.inf), axis=0)
    after = np.minimum.accumulate(np.where(is_known, rows, np.inf)[::-1], axis=0)[::-1]
    return np.asarray(np.minimum(rows - before, after - rows) <= longest_gap / 2)
