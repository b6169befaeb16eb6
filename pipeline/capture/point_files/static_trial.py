"""Joint centres of a marker set, defined by a static trial, in trials in which markers of the joints are gone.

A static trial has more markers than a movement: both sides of knees and ankles, for example. Markers that keep their
distances in both files lie on one segment. Each joint that the static trial tells by markers that the movement lacks is
carried along by the nearest segment of three markers or more: its pose is the rigid motion that fits the markers best
(Soederkvist and Wedin, "Determining the movements of the skeleton using well-configured markers", J. Biomech. 26,
1993).
"""

from collections.abc import Mapping
from typing import cast

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.distance import pdist

from pipeline.capture.point_files.point_names import OWN_NAMES, find_joints
from pipeline.capture.point_files.point_reader import PointTable
from pipeline.core.errors import InputError, Problem
from pipeline.core.options.job_choices import UNITS_M, Units
from pipeline.core.problems.session_codes import KEYPOINTS_LAYOUT

# Root mean square change of distances on a segment, by skin that moves over bones (Leardini et al., "Human movement
# analysis using stereophotogrammetry, part 3", Gait & Posture 21, 2005); least number of markers, and their least
# spread across the longest direction.
_SKIN_M, _LEAST_MARKERS, _LEAST_SPREAD_M = 0.01, 3, 0.015
# Least number of frames, all over a longer movement, in which distances of markers are compared.
_COMPARED_FRAMES = 500
# Joints that follow from the pelvis in each trial.
_OF_PELVIS = ("left_hip", "right_hip")


def with_static_joints(
    table: PointTable, static: PointTable, joint_of: Mapping[str, str], units: Units | None = None
) -> PointTable:
    """Points of a movement, and the joints that a static trial of the same markers defines, named as our joints.

    ``units``: unit of both files; ``None``: each states its own. Raises ``InputError`` if a unit is unknown, the files
    share too few markers, or the static trial defines no joint beyond theirs.
    """
    if any((units or of.unit) not in UNITS_M for of in (table, static)):
        message = "The movement and its static trial must state their unit, or have one that you state."
        raise InputError([Problem(KEYPOINTS_LAYOUT, message, field="units", hint="State the unit of both.")])
    shared = [name for name in table.names if table.names.count(name) == static.names.count(name) == 1]
    own_m, static_m = (UNITS_M[cast(Units, units or of.unit)] for of in (table, static))
    moving_m = table.xyz[:, [table.names.index(name) for name in shared]] * own_m
    still_m = _median(static.xyz[:, [static.names.index(name) for name in shared]]) * static_m
    segments = _segments(moving_m, still_m)
    of_static, _ = find_joints(static.names, joint_of)
    wanted = {
        joint: points
        for joint, points in of_static.items()
        if joint in OWN_NAMES and joint not in _OF_PELVIS and not {static.names[k] for k in points} <= {*table.names}
    }
    joints_m = {joint: _median(static.xyz[:, points]).mean(0) * static_m for joint, points in wanted.items()}
    if not joints_m or not segments:
        message = (
            "The static trial defines no joint: it needs markers on both sides of joints, which the movement lacks, "
            "and three markers on a segment that both files have."
        )
        raise InputError([Problem(KEYPOINTS_LAYOUT, message, field="static")])
    carried = {}
    for joint, joint_m in joints_m.items():
        nearest = min(segments, key=lambda rows: float(np.linalg.norm(still_m[rows] - joint_m, axis=-1).mean()))
        carried[joint] = _carried(moving_m[:, nearest], still_m[nearest], joint_m) / own_m
    kept = [k for k, name in enumerate(table.names) if name not in carried]
    xyz = np.concatenate([table.xyz[:, kept], np.stack([*carried.values()], axis=1)], axis=1)
    names = (*(table.names[k] for k in kept), *carried)
    return PointTable(names, xyz, table.rate_hz, table.unit, table.up, table.start_s, table.world_from_segment)


def _median(xyz: Float[np.ndarray, "frames points 3"]) -> Float[np.ndarray, "points 3"]:
    """Place of each point in the frames of a still person; NaN where it is never known."""
    known = np.isfinite(xyz).all(-1).any(0)
    place = np.full(xyz.shape[1:], np.nan)
    place[known] = np.nanmedian(xyz[:, known], axis=0)
    return place


def _segments(
    moving_m: Float[np.ndarray, "frames points 3"], still_m: Float[np.ndarray, "points 3"]
) -> list[Int[np.ndarray, " markers"]]:
    """Markers of each segment: all of them keep the distances that they have in the static trial."""
    from scipy.cluster.hierarchy import fcluster, linkage  # noqa: PLC0415 - slow to import, and seldom needed

    moving_m = moving_m[:: max(1, len(moving_m) // _COMPARED_FRAMES)]
    usable = np.flatnonzero(np.isfinite(still_m).all(-1) & np.isfinite(moving_m).all(-1).any(0))
    if len(usable) < _LEAST_MARKERS:
        return []
    still_apart_m = pdist(still_m[usable])
    summed_m2, num_known = np.zeros_like(still_apart_m), np.zeros(len(still_apart_m), int)
    for frame_m in moving_m[:, usable]:
        change_m2 = (pdist(frame_m) - still_apart_m) ** 2
        known = np.isfinite(change_m2)
        summed_m2[known] += change_m2[known]
        num_known += known
    distance_m = np.where(num_known > 0, np.sqrt(summed_m2 / np.maximum(num_known, 1)), 1.0)
    labels = fcluster(linkage(distance_m, "complete"), _SKIN_M, "distance")
    groups = [usable[labels == label] for label in np.unique(labels)]
    return [
        rows
        for rows in groups
        if len(rows) >= _LEAST_MARKERS
        and np.linalg.svd(still_m[rows] - still_m[rows].mean(0), compute_uv=False)[1] > _LEAST_SPREAD_M
    ]


def _carried(
    moving_m: Float[np.ndarray, "frames markers 3"],
    still_m: Float[np.ndarray, "markers 3"],
    joint_m: Float[np.ndarray, " 3"],
) -> Float[np.ndarray, "frames 3"]:
    """Place of a joint that moves with markers; NaN in frames with fewer than three of them."""
    known = np.isfinite(moving_m).all(-1)
    weight = known / np.maximum(known.sum(1, keepdims=True), 1)
    middle_m = np.einsum("fm,fmk->fk", weight, np.nan_to_num(moving_m))
    still_middle_m = weight @ still_m
    arms_m = np.where(known[..., None], np.nan_to_num(moving_m) - middle_m[:, None], 0.0)
    still_arms_m = still_m - still_middle_m[:, None]
    left, _, right = np.linalg.svd(np.einsum("fmi,fmj->fij", arms_m, still_arms_m))
    right[:, 2] *= np.sign(np.linalg.det(left @ right))[:, None]
    place_m = middle_m + np.einsum("fij,fj->fi", left @ right, joint_m - still_middle_m)
    return np.where((known.sum(1) >= _LEAST_MARKERS)[:, None], place_m, np.nan)
