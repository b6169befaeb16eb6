"""Everybody's bone lengths, from poses that were found without them (section 3.6)."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from pipeline.clustering.skeleton import Skeleton


class LimbLengths(NamedTuple):
    """What is known of the length of the limb from each joint to its parent.

    Parameters
    ----------
    known_m
        The length sets L of eq. 3, (joints, people); NaN for a person whose limb was not measured, and for all where a
        limb's length is not constant.
    longest_m
        No limb is longer, (joints,).
    """

    known_m: np.ndarray
    longest_m: np.ndarray

    @property
    def is_measured(self) -> Bool[np.ndarray, " joints"]:
        """Whether anybody's length is known."""
        return ~np.isnan(self.known_m).all(-1)


def unknown_lengths(skeleton: Skeleton) -> LimbLengths:
    """What is known before anybody was seen."""
    return LimbLengths(np.empty((len(skeleton.names), 0)), np.array(skeleton.longest_m))


def unlimited_lengths(skeleton: Skeleton) -> LimbLengths:
    """What the paper's ablation without bone lengths knows: nothing, not even what a human being is."""
    return LimbLengths(np.empty((len(skeleton.names), 0)), np.full(len(skeleton.names), np.inf))


def measure_lengths(people_m: Sequence[Float[np.ndarray, "_ joints 3"]], skeleton: Skeleton) -> LimbLengths:
    """The median length of each person's limbs of constant length.

    Parameters
    ----------
    people_m
        One person's poses each, NaN where a joint was not found.
    """
    known_m = np.full((len(skeleton.names), len(people_m)), np.nan)
    for j in np.flatnonzero(skeleton.is_constant):
        for person, poses_m in enumerate(people_m):
            lengths_m = np.linalg.norm(poses_m[:, j] - poses_m[:, skeleton.parents[j]], axis=-1)
            if np.isfinite(lengths_m).any():
                known_m[j, person] = np.nanmedian(lengths_m)
    return LimbLengths(known_m, np.array(skeleton.longest_m))
