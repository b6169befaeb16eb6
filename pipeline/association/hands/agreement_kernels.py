"""Compiled search for the hand that the views of a person agree on.

A detection has two hands. In each view a side of the person may be the hand of the same side, the other hand (detectors
exchange them), or neither (the hand of another person, or a wrong one). Every two views that see a hand give a
hypothesis: the knuckles where their rays meet, near the person's wrist. The hypothesis that most views support wins.
"""

from typing import NamedTuple, no_type_check

import numpy as np

from pipeline.core.runtime.jit import kernel

# Fewest knuckles that two views must share.
_LEAST_KNUCKLES = 3


class Agreement(NamedTuple):
    """Settings of the search, and workspace: kernels allocate no memory."""

    reach_m: float  # mean distance of the knuckles from a view's rays at which its support is 0
    palm_m: float  # largest distance of the knuckles' mean from the wrist
    least_sine2: float  # squared sine of the angle between two rays below which their depth is unknown
    exchanged_share: float  # share of a hand's support that counts if it is the hand of the other side
    met_m: np.ndarray  # (knuckles, 3): knuckles of the current hypothesis
    best_m: np.ndarray  # (2, knuckles, 3): knuckles of the best hypothesis of each side
    support: np.ndarray  # (cameras, 2): support of the chosen hand of each side


@kernel
@no_type_check
def _off_m(ray, center_m, point_m):
    """Distance of a point from a ray; NaN if either is unknown."""
    x, y, z = point_m[0] - center_m[0], point_m[1] - center_m[1], point_m[2] - center_m[2]
    along = x * ray[0] + y * ray[1] + z * ray[2]
    x, y, z = x - along * ray[0], y - along * ray[1], z - along * ray[2]
    return np.sqrt(x * x + y * y + z * z)


@kernel
@no_type_check
def _support(agreement, rays, center_m, weight, points_m):
    """Support of a view's hand for a hypothesis, from 0 to the hand's weight."""
    total, count = 0.0, 0
    for k in range(len(rays)):
        off_m = _off_m(rays[k], center_m, points_m[k])
        if off_m == off_m:
            total += min(off_m, 2 * agreement.reach_m)
            count += 1
    if count < _LEAST_KNUCKLES:
        return 0.0
    share = total / (count * agreement.reach_m)
    return weight * max(0.0, 1.0 - share * share)


@kernel
@no_type_check
def _can_be_held(agreement, rays, center_m, wrist_m):
    """Return whether the mean distance of a hand's rays from the wrist allows that it is the wrist's hand."""
    total, count = 0.0, 0
    for k in range(len(rays)):
        off_m = _off_m(rays[k], center_m, wrist_m)
        if off_m == off_m:
            total += off_m
            count += 1
    return count >= _LEAST_KNUCKLES and total <= count * agreement.palm_m


@kernel
@no_type_check
def _meet(agreement, one, other, one_center_m, other_center_m, wrist_m):
    """Compute the points nearest to both views' rays into ``met_m``; return whether they are knuckles at the wrist."""
    count = 0
    mean_x, mean_y, mean_z = 0.0, 0.0, 0.0
    for k in range(len(one)):
        cos = one[k, 0] * other[k, 0] + one[k, 1] * other[k, 1] + one[k, 2] * other[k, 2]
        sine2 = 1.0 - cos * cos
        known = sine2 > agreement.least_sine2
        along_one, along_other = 0.0, 0.0
        for axis in range(3):
            apart_m = other_center_m[axis] - one_center_m[axis]
            along_one += apart_m * one[k, axis]
            along_other += apart_m * other[k, axis]
        over = 1.0 / sine2
        first_m, second_m = (along_one - cos * along_other) * over, (cos * along_one - along_other) * over
        known = known and first_m > 0 and second_m > 0
        for axis in range(3):
            middle_m = 0.5 * (
                one_center_m[axis] + first_m * one[k, axis] + other_center_m[axis] + second_m * other[k, axis]
            )
            agreement.met_m[k, axis] = middle_m if known else np.nan
        if known:
            count += 1
            mean_x += agreement.met_m[k, 0]
            mean_y += agreement.met_m[k, 1]
            mean_z += agreement.met_m[k, 2]
    if count < _LEAST_KNUCKLES:
        return False
    x, y, z = mean_x / count - wrist_m[0], mean_y / count - wrist_m[1], mean_z / count - wrist_m[2]
    return x * x + y * y + z * z <= agreement.palm_m * agreement.palm_m


@kernel
@no_type_check
def _weight_for(agreement, weights, side, hand):
    """Weight of a hand of a detection as the hand of a side of the person."""
    return weights[hand] if hand == side else agreement.exchanged_share * weights[hand]


@kernel
@no_type_check
def _total_support(agreement, rays, weights, centers_m, side):
    """Support of all views for the current hypothesis; each view counts by the better one of its hands."""
    total = 0.0
    for view in range(len(rays)):
        support = 0.0
        for hand in range(2):
            weight = _weight_for(agreement, weights[view], side, hand)
            if weight > 0:
                seen = rays[view, hand], centers_m[view], weight
                support = max(support, _support(agreement, *seen, agreement.met_m))
        total += support
    return total


@kernel
@no_type_check
def _find_best(agreement, rays, weights, centers_m, wrist_m, side):
    """Compute the knuckles with the most support into ``best_m``; return whether there are any."""
    num_views, most = len(rays), 0.0
    for first in range(num_views):
        for first_hand in range(2):
            if not (
                weights[first, first_hand] > 0
                and _can_be_held(agreement, rays[first, first_hand], centers_m[first], wrist_m[side])
            ):
                continue
            for second in range(first + 1, num_views):
                for second_hand in range(2):
                    if not weights[second, second_hand] > 0:
                        continue
                    pair = rays[first, first_hand], rays[second, second_hand], centers_m[first], centers_m[second]
                    if not _meet(agreement, *pair, wrist_m[side]):
                        continue
                    total = _total_support(agreement, rays, weights, centers_m, side)
                    if total > most:
                        most = total
                        for k in range(len(agreement.met_m)):
                            for axis in range(3):
                                agreement.best_m[side, k, axis] = agreement.met_m[k, axis]
    return most > 0


@kernel
@no_type_check
def _keep_two(chosen, side):
    """Drop a side's hand if fewer than two views are left."""
    count = 0
    for view in range(len(chosen)):
        count += 1 if chosen[view, side] >= 0 else 0
    if count < 2:
        for view in range(len(chosen)):
            chosen[view, side] = -1


@kernel
@no_type_check
def choose_hands(agreement, rays, weights, centers_m, wrist_m, chosen):
    """Choose the hand of each view for both sides of a person, frame by frame.

    - ``agreement``: settings and workspace.
    - ``rays``: unit rays of the knuckles of each detection's left and right hand, (frames, cameras, 2, knuckles, 3);
      NaN where a knuckle was not found.
    - ``weights``: weight of each hand, (frames, cameras, 2); 0 without a hand.
    - ``centers_m``: centres of the cameras, (cameras, 3).
    - ``wrist_m``: left and right wrist of the person, (frames, 2, 3); NaN where it is unknown: that side has no hand
      then.
    - ``chosen``: output: number of the detection's hand that is the hand of each side, (frames, cameras, 2); -1 for
      none.
    """
    for frame in range(len(chosen)):
        ours = chosen[frame]
        for side in range(2):
            known = wrist_m[frame, side, 0] == wrist_m[frame, side, 0]
            found = known and _find_best(agreement, rays[frame], weights[frame], centers_m, wrist_m[frame], side)
            for view in range(len(ours)):
                ours[view, side] = -1
                agreement.support[view, side] = 0.0
                if not found:
                    continue
                for hand in range(2):
                    weight = _weight_for(agreement, weights[frame, view], side, hand)
                    if weight > 0:
                        seen = rays[frame, view, hand], centers_m[view], weight
                        support = _support(agreement, *seen, agreement.best_m[side])
                        if support > agreement.support[view, side]:
                            agreement.support[view, side] = support
                            ours[view, side] = hand
        for view in range(len(ours)):
            if ours[view, 0] == ours[view, 1]:  # a hand is of one side
                ours[view, 0 if agreement.support[view, 0] < agreement.support[view, 1] else 1] = -1
        for side in range(2):
            _keep_two(ours, side)
