"""Compiled loops that end targets: unseen for too long, or duplicates of another target."""

from typing import no_type_check

import numpy as np

from pipeline.association.tracking.kernels.state import MIN_JOINTS
from pipeline.core.runtime.jit import inlined


@inlined
@no_type_check
def bury(targets, time_s, limits):
    """End targets that no two cameras have seen for longer than their limit."""
    kept = 0
    for place in range(targets.alive[0]):
        slot = targets.order[place]
        target = targets.state[slot]
        limit_s = limits.max_unseen_s if target.confirmed else limits.max_unseen_tentative_s
        if time_s - max(target.supported_s, target.moved_s) <= limit_s:
            targets.order[place], targets.order[kept] = targets.order[kept], slot
            kept += 1
    targets.alive[0] = kept


@inlined
@no_type_check
def _same_place(one, other, duplicate_m):
    count, x, y, z = 0.0, 0.0, 0.0, 0.0
    for k in range(one.views.shape[0]):
        dx, dy, dz = (
            one.xyz_m[0, k] - other.xyz_m[0, k],
            one.xyz_m[1, k] - other.xyz_m[1, k],
            one.xyz_m[2, k] - other.xyz_m[2, k],
        )
        known = dx == dx
        count += 1.0 if known else 0.0
        x += dx if known else 0.0
        y += dy if known else 0.0
        z += dz if known else 0.0
    # The mean distance is at least the distance of the means.
    if count < MIN_JOINTS or x * x + y * y + z * z >= (duplicate_m * count) ** 2:
        return False
    total_m = 0.0
    for k in range(one.views.shape[0]):
        dx, dy, dz = (
            one.xyz_m[0, k] - other.xyz_m[0, k],
            one.xyz_m[1, k] - other.xyz_m[1, k],
            one.xyz_m[2, k] - other.xyz_m[2, k],
        )
        apart_m = np.sqrt(dx * dx + dy * dy + dz * dz)
        total_m += apart_m if dx == dx else 0.0
    return total_m < duplicate_m * count


@inlined
@no_type_check
def _is_better(one, other, time_s, limits):
    """True if the first of two duplicates stays: by recent support, then by number of supports, then by age."""
    one_is_old = time_s - one.supported_s > limits.velocity_window_s
    other_is_old = time_s - other.supported_s > limits.velocity_window_s
    if one_is_old != other_is_old:
        return other_is_old
    if one.num_supported != other.num_supported:
        return one.num_supported > other.num_supported
    return one.target_id < other.target_id


@inlined
@no_type_check
def merge_duplicates(targets, time_s, limits, replaced_by, room):
    """Merge targets at the same place: the better of two stays."""
    count = targets.alive[0]
    gone = room.gone
    gone[:count] = False
    any_gone = False
    for i in range(count):
        for j in range(i + 1, count):
            one, other = targets.state[targets.order[i]], targets.state[targets.order[j]]
            if gone[i] or gone[j] or not _same_place(one, other, limits.duplicate_m):
                continue
            any_gone = True
            stays = _is_better(one, other, time_s, limits)
            gone[j if stays else i] = True
            loser, twin = (other, one) if stays else (one, other)
            if not loser.confirmed:
                replaced_by[loser.target_id] = twin.target_id
    if any_gone:
        kept = 0
        for place in range(count):
            slot = targets.order[place]
            if not gone[place]:
                targets.order[place], targets.order[kept] = targets.order[kept], slot
                kept += 1
        targets.alive[0] = kept
