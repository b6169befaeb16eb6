"""Arrays of the tracker's state, as the kernels take them.

The state of a target is a record. Its arrays have the joints as last axis, padded to a multiple of four lanes whose
number is known when a loop is compiled. So loops over the joints are vectorised.
"""

from functools import cache
from typing import NamedTuple

import numpy as np

from pipeline.core.runtime.jit import record_dtype, round_up, zero_records

# Least number of shared joints for an affinity.
MIN_JOINTS = 3
# Positions kept for a velocity; a position soon after the newest replaces it.
NUM_RECENT = 8
# Six entries of a symmetric 3x3 matrix, and three of the right-hand side of the normal equations.
NUM_NORMAL = 9
_NUM_SUMS = 9
# Lanes of a vector of doubles; the number of a record's lanes is a multiple of it.
LANES = 4
# Detections in a record of planes.
FENCED = 8


@cache
def target_dtype(lanes: int) -> np.dtype:
    """Record of a target's state (section 3.2).

    ``xyz_m`` and ``updated_s`` are the last position of each joint, NaN before the first, and its time t';
    ``velocity_m_s`` is 0 while unknown. ``recent_m`` and ``recent_s`` are the positions and times behind the velocity,
    ``is_fitted`` tells whether it includes the newest of them. ``moved_s`` is the time at which a joint was last
    located, ``supported_s`` the last instant at which two cameras saw the target together; ``num_supported`` such
    instants confirm it.
    """
    return record_dtype(
        ("xyz_m", np.float64, (3, lanes)),
        ("updated_s", np.float64, (lanes,)),
        ("velocity_m_s", np.float64, (3, lanes)),
        ("expected_m", np.float64, (3, lanes)),  # predicted joints at the current frame
        ("offset_m", np.float64, (3, lanes)),  # predicted joints minus the centre of the current camera
        ("squared_m2", np.float64, (lanes,)),  # squared length of offset_m
        ("decay_3d", np.float64, (lanes,)),  # w3D exp(-lambda_a (t - t'))
        ("low_m", np.float64, (3, LANES)),  # least and largest offset_m, by lane
        ("high_m", np.float64, (3, LANES)),
        ("normal_sum", np.float64, (NUM_NORMAL, lanes)),  # normal equations of all views, like sum_s
        ("views", np.float64, (lanes,)),  # number of views in normal_sum
        ("recent_m", np.float64, (NUM_RECENT, 3, lanes)),
        ("recent_s", np.float64, (NUM_RECENT,)),
        ("target_id", np.int64),
        ("sum_s", np.float64),
        ("oldest_s", np.float64),  # no view in normal_sum is older
        ("recent_since_s", np.float64),  # time at which the newest entry of recent_m was created
        ("num_recent", np.int64),
        ("is_fitted", np.bool_),
        ("moved_s", np.float64),
        ("supported_s", np.float64),
        ("num_supported", np.int64),
        ("confirmed", np.bool_),
    )


@cache
def view_dtype(lanes: int) -> np.dtype:
    """Record of a target's last match in a camera."""
    return record_dtype(("normal", np.float64, (NUM_NORMAL, lanes)), ("last_px", np.float64, (2, lanes)))


@cache
def body_dtype(lanes: int) -> np.dtype:
    """Record of a detection in the current frame."""
    return record_dtype(
        ("points_px", np.float64, (2, lanes)),
        ("rays", np.float64, (3, lanes)),
        ("score", np.float64, (lanes,)),
        ("low_px", np.float64, (2, LANES)),  # least and largest points_px of used joints, by lane
        ("high_px", np.float64, (2, LANES)),
    )


@cache
def sums_dtype(lanes: int) -> np.dtype:
    """Record of the sums of the least-squares fit of velocities."""
    return record_dtype(("fit", np.float64, (_NUM_SUMS, lanes)))


@cache
def fence_dtype() -> np.dtype:
    """Record of the planes around the rays of some detections."""
    return record_dtype(
        ("border_px", np.float64, (4, FENCED)),  # right, left, lower and upper border of the box around the joints
        ("normal", np.float64, (4, 3, FENCED)),
        ("is_far", np.float64, (FENCED,)),  # 1 where the detection is far from the current target, else 0
    )


class RigGeometry(NamedTuple):
    """Geometry of all cameras."""

    image_from_world: np.ndarray  # (cameras, 3, 4)
    world_ray_from_image: np.ndarray  # (cameras, 3, 3)
    center_m: np.ndarray  # (cameras, 3)
    fundamental: np.ndarray  # (cameras, cameras, 3, 3), [left, right]


class Frames(NamedTuple):
    """Frames of all cameras in time order; rows ``first:last`` of the last arrays are a frame's detections."""

    time_s: np.ndarray
    camera: np.ndarray
    first: np.ndarray
    last: np.ndarray
    points_px: np.ndarray  # (detections, joints, 2), undistorted
    score: np.ndarray  # (detections, joints), 0 where a joint is not used
    flat_px: np.ndarray  # points_px as (detections, 2 * joints), for vectorised loops


class Limits(NamedTuple):
    """``TrackingParameters`` that the kernels use, as a tuple of numbers."""

    alpha_2d_px_s: float
    alpha_epipolar_px: float
    alpha_3d_m: float
    weight_2d: float
    weight_3d: float
    lambda_a_hz: float
    lambda_t_hz: float
    instant_s: float
    velocity_window_s: float
    confirm_instants: int
    max_unseen_s: float
    max_unseen_tentative_s: float
    max_extrapolation_s: float
    duplicate_m: float


class Targets(NamedTuple):
    """Slots for targets; the first ``alive[0]`` entries of ``order`` are the slots in use, in order of creation."""

    alive: np.ndarray
    order: np.ndarray
    state: np.ndarray  # (slots,) of target_dtype
    views: np.ndarray  # (slots, cameras) of view_dtype
    matched_s: np.ndarray  # (slots, cameras)
    counted: np.ndarray  # (slots, cameras): whether normal_sum includes the view
    bodies: np.ndarray  # (most detections in a frame,) of body_dtype
    sums: np.ndarray  # (1,) of sums_dtype


class Workspace(NamedTuple):
    """Work arrays: kernels allocate none, so that they need no reference counting."""

    affinity: np.ndarray  # (slots, most detections in a frame)
    match: np.ndarray  # (slots,)
    rows: np.ndarray  # (slots,)
    columns: np.ndarray  # (most detections,)
    free: np.ndarray  # (most detections,)
    gone: np.ndarray  # (slots,)
    fences: np.ndarray  # (most detections / FENCED,) of fence_dtype
    wanted: np.ndarray  # (most detections,)
    decay_2d: np.ndarray  # (slots,): w2D exp(-lambda_a (t - t''))
    scale_2d: np.ndarray  # (slots,): 1 / (alpha2D (t - t''))
    pair_target: np.ndarray  # (slots * most detections,): pairs that may have a positive affinity
    pair_detection: np.ndarray
    pair_affinity: np.ndarray
    gain: np.ndarray  # (side, side), where side is the larger of slots and most detections
    row_price: np.ndarray  # (side + 1,), as the arrays that follow
    column_price: np.ndarray
    row_of: np.ndarray
    before: np.ndarray
    slack: np.ndarray
    done: np.ndarray


class Pool(NamedTuple):
    """Unmatched detections of each camera's most recent frame."""

    rows: np.ndarray  # (cameras, most detections in a frame)
    num_rows: np.ndarray
    time_s: np.ndarray


class Outcome(NamedTuple):
    """Result of tracking."""

    identity: np.ndarray  # (detections,): target of each detection, UNASSIGNED for none
    replaced_by: np.ndarray  # (targets,): target that a duplicate was merged into, else -1
    earned: np.ndarray  # (targets,): whether the target was ever confirmed
    merged_s: np.ndarray  # (1,): time of the last search for duplicates


def make_targets(num_slots: int, num_cameras: int, num_joints: int, most_detections: int) -> Targets:
    """Allocate slots for targets, none of them in use."""
    lanes = round_up(num_joints)
    return Targets(
        alive=np.zeros(1, np.int64),
        order=np.arange(num_slots),
        state=zero_records(num_slots, target_dtype(lanes)),
        views=zero_records((num_slots, num_cameras), view_dtype(lanes)),
        matched_s=np.zeros((num_slots, num_cameras)),
        counted=np.zeros((num_slots, num_cameras), bool),
        bodies=zero_records(most_detections, body_dtype(lanes)),
        sums=zero_records(1, sums_dtype(lanes)),
    )


def make_workspace(num_slots: int, most_detections: int) -> Workspace:
    """Allocate the work arrays of the kernels."""
    side = max(num_slots, most_detections)
    return Workspace(
        affinity=np.empty((num_slots, most_detections)),
        match=np.empty(num_slots, np.int64),
        rows=np.empty(num_slots, np.int64),
        columns=np.empty(most_detections, np.int64),
        free=np.empty(most_detections, bool),
        gone=np.empty(num_slots, bool),
        fences=zero_records(-(-most_detections // FENCED), fence_dtype()),
        wanted=np.empty(most_detections, np.int64),
        decay_2d=np.empty(num_slots),
        scale_2d=np.empty(num_slots),
        pair_target=np.empty(num_slots * most_detections + 1, np.int64),
        pair_detection=np.empty(num_slots * most_detections + 1, np.int64),
        pair_affinity=np.empty(num_slots * most_detections + 1),
        gain=np.empty((side, side)),
        row_price=np.empty(side + 1),
        column_price=np.empty(side + 1),
        row_of=np.empty(side + 1, np.int64),
        before=np.empty(side + 1, np.int64),
        slack=np.empty(side + 1),
        done=np.empty(side + 1, bool),
    )
