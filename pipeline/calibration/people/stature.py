"""Statures of people from the lengths of their segments, and the scale at which they are known ones."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment

from pipeline.calibration.people.following import JOINTS

# Shin, thigh and trunk as shares of stature (Drillis and Contini 1966).
_SHARE = 0.246 + 0.245 + 0.288
_MIN_BODIES = 10
# Logarithm of a ratio of statures that counts as much as having none; instants at which two groups are seen together.
_FOREIGN, _TOGETHER = 0.25, 5
# Distance of the joints of one person in two groups, as a share of the stature.
_SAME_PERSON = 0.15


def _pair(kind: str) -> list[int]:
    return [JOINTS.index(f"{side}_{kind}") for side in ("left", "right")]


@dataclass(frozen=True, slots=True, eq=False)
class Statures:
    """Statures of groups of bodies, in the unit of the points."""

    estimates: Float[np.ndarray, " groups"]
    weights: Float[np.ndarray, " groups"]  # Number of bodies behind each
    group: Int[np.ndarray, " groups"]  # Numbers of the groups

    def __len__(self) -> int:
        return len(self.estimates)


class StatureMatch(NamedTuple):
    """Known statures of groups, and the scale."""

    scale: float  # Metres a unit
    stature: Int[np.ndarray, " groups"]  # Number of each group's stature, -1 where none is left


def statures(xyz: Float[np.ndarray, "n joints 3"], group: Int[np.ndarray, " n"]) -> Statures:
    """Estimate the stature of each group of which shin, thigh and trunk are known often enough."""
    ankle, knee, hip, shoulder = (xyz[:, _pair(kind)] for kind in ("ankle", "knee", "hip", "shoulder"))
    lengths = (
        np.linalg.norm(ankle - knee, axis=-1),
        np.linalg.norm(knee - hip, axis=-1),
        np.linalg.norm(shoulder.mean(1) - hip.mean(1), axis=-1)[:, None],
    )
    estimates, weights, groups = [], [], []
    for number in np.unique(group):
        own = [length[group == number] for length in lengths]
        known = [lengths_of_bone[np.isfinite(lengths_of_bone)] for lengths_of_bone in own]
        if min(map(len, known)) >= _MIN_BODIES:
            estimates.append(sum(float(np.median(lengths_of_bone)) for lengths_of_bone in known) / _SHARE)
            weights.append(float(min(map(len, known))))
            groups.append(int(number))
    return Statures(np.array(estimates), np.array(weights), np.array(groups, int))


def others_at_once(
    found: Statures,
    xyz: Float[np.ndarray, "n joints 3"],
    group: Int[np.ndarray, " n"],
    instant: Int[np.ndarray, " n"],
) -> Bool[np.ndarray, "groups groups"]:
    """Pairs of groups that are seen at the same instants at different places: two people."""
    rows = {number: np.flatnonzero(group == number) for number in found.group.tolist()}
    are_others = np.zeros((len(found), len(found)), bool)
    for later in range(len(found)):
        for earlier in range(later):
            of_later, of_earlier = rows[int(found.group[later])], rows[int(found.group[earlier])]
            _, first, second = np.intersect1d(instant[of_later], instant[of_earlier], return_indices=True)
            apart = np.linalg.norm(xyz[of_later[first]] - xyz[of_earlier[second]], axis=-1)
            apart = apart[np.isfinite(apart)]
            limit = _SAME_PERSON * min(found.estimates[later], found.estimates[earlier])
            are_others[later, earlier] = len(first) >= _TOGETHER and len(apart) > 0 and np.median(apart) > limit
    return are_others | are_others.T


def match_statures(
    found: Statures, are_others: Bool[np.ndarray, "groups groups"], stature_m: Sequence[float]
) -> StatureMatch:
    """Find the scale at which estimated statures are closest to known ones, and the stature of each group.

    One stature holds for all people. Several belong to one person each: people who are seen at once have different
    ones, and the taller one of two has the larger one. Closeness is the sum of absolute logarithms of ratios.
    """
    known = np.log(np.array(stature_m))
    estimates = np.log(found.estimates)
    best, lowest = StatureMatch(1.0, np.full(len(found), -1)), np.inf
    for scale in np.unique(known[:, None] - estimates[None]):
        apart = np.abs(estimates[:, None] + scale - known)
        if len(known) == 1:
            chosen = np.zeros(len(found), int)
        else:
            chosen = _chosen(np.minimum(apart, _FOREIGN) * found.weights[:, None], are_others)
        costs = np.where(chosen >= 0, np.take_along_axis(apart, np.maximum(chosen, 0)[:, None], 1)[:, 0], _FOREIGN)
        if (total := float((costs * found.weights).sum())) < lowest:
            best, lowest = StatureMatch(float(np.exp(scale)), chosen), total
    return best


def _chosen(
    cost: Float[np.ndarray, "groups statures"], are_others: Bool[np.ndarray, "groups groups"]
) -> Int[np.ndarray, " groups"]:
    """Statures of groups: of most people who are seen at once together, then of the other groups, longest first."""
    chosen = np.full(len(cost), -1)
    first = _largest_party(are_others)
    rows, columns = linear_sum_assignment(cost[first])
    chosen[first[rows]] = columns
    is_open = np.ones(len(cost), bool)
    is_open[first] = False
    for number in np.flatnonzero(is_open):
        taken = chosen[are_others[number] & (chosen >= 0)]
        of_group = cost[number].copy()
        of_group[taken] = np.inf
        if np.isfinite(of_group).any():
            chosen[number] = int(of_group.argmin())
    return chosen


def _largest_party(are_others: Bool[np.ndarray, "groups groups"]) -> Int[np.ndarray, " party"]:
    """Groups of different people any two of which are seen at once: the largest set that grows from any group."""
    best = np.empty(0, int)
    for start in range(len(are_others)):
        party = [start]
        for number in np.flatnonzero(are_others[start]).tolist():
            if are_others[number, party].all():
                party.append(number)
        if len(party) > len(best):
            best = np.array(party)
    return best


def scale_from(found: Statures, stature_m: float) -> float:
    """Metres a unit at which the estimated statures are closest to one that all people have."""
    return match_statures(found, np.zeros((len(found), len(found)), bool), [stature_m]).scale
