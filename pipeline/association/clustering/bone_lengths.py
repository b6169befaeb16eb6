"""Bone lengths of all people, measured from poses of a first pass without lengths (section 3.6)."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from pipeline.association.clustering.skeleton import Skeleton


class LimbLengths(NamedTuple):
    """Lengths of the limbs from each joint to its parent."""

    # Length sets L of eq. 3, (joints, people); NaN for a limb that was not measured or whose length is not constant
    known_m: np.ndarray
    longest_m: np.ndarray  # Upper limit of each limb's length, (joints,)

    @property
    def is_measured(self) -> Bool[np.ndarray, " joints"]:
        """Return whether the length of the joint's limb is known for any person."""
        return ~np.isnan(self.known_m).all(-1)


def unknown_lengths(skeleton: Skeleton) -> LimbLengths:
    """Make lengths for the first pass: upper limits only."""
    return LimbLengths(np.empty((len(skeleton.names), 0)), np.array(skeleton.longest_m))


def unlimited_lengths(skeleton: Skeleton) -> LimbLengths:
    """Make lengths for the paper's ablation without bone lengths: no upper limits either."""
    return LimbLengths(np.empty((len(skeleton.names), 0)), np.full(len(skeleton.names), np.inf))


def measure_lengths(people_m: Sequence[Float[np.ndarray, "_ joints 3"]], skeleton: Skeleton) -> LimbLengths:
    """Measure each person's limbs of constant length by the median over the person's poses.

    Poses are in metres, NaN where a joint was not found.
    """
    known_m = np.full((len(skeleton.names), len(people_m)), np.nan)
    for j in np.flatnonzero(skeleton.is_constant):
        for person, poses_m in enumerate(people_m):
            lengths_m = np.linalg.norm(poses_m[:, j] - poses_m[:, skeleton.parents[j]], axis=-1)
            if np.isfinite(lengths_m).any():
                known_m[j, person] = np.nanmedian(lengths_m)
    return LimbLengths(known_m, np.array(skeleton.longest_m))
