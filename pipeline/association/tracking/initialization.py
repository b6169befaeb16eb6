"""Start of targets from unmatched detections: new or lost targets (Chen et al. 2020, supplement, eq. 12-16)."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import Bounds, LinearConstraint, linear_sum_assignment, milp
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from pipeline.association.tracking.kernels.state import MIN_JOINTS, RigGeometry
from pipeline.association.tracking.tracking_parameters import TrackingParameters
from pipeline.geometry.epipolar import epipolar_distance_px

# Affinity of a forbidden pair for solvers, which can't add infinite values.
_NEVER = -1e3
# Most detections of a programme: 16 take up to a second, and constraints grow with the third power of the number.
# Connected parts of the simulated scenes have 13 detections at most.
_MAX_PROGRAMME_NODES = 16
# Detections of all programmes of a partition together.
_MAX_NODES = 32
# Branches of the search tree of a programme; programmes of the simulated scenes are solved at the root.
_MAX_BRANCHES = 1000


class Partition(NamedTuple):
    """Partition of several cameras' detections into people."""

    parts: tuple[tuple[int, ...], ...]  # Detections of each person, at least two, ascending
    is_exact: bool  # True if the partition is optimal; if not, some parts were matched camera by camera


def assign(affinities: Float[np.ndarray, "targets detections"]) -> list[tuple[int, int]]:
    """Match targets and detections for the maximum total affinity (Hungarian algorithm).

    The pairs (target, detection) each have a positive affinity.
    """
    gain = np.maximum(affinities, 0.0)
    rows, columns = linear_sum_assignment(gain, maximize=True)
    return [(int(i), int(j)) for i, j in zip(rows, columns, strict=True) if affinities[i, j] > 0]


def partition(affinities: Float[np.ndarray, "nodes nodes"], groups: Int[np.ndarray, " nodes"]) -> Partition:
    """Partition detections of several cameras into people (Chen et al. 2020, eq. 14-16).

    Maximises the sum of affinities within parts. Cycle consistency, ``y_ij + y_jk <= 1 + y_ik`` for all i, j, k, makes
    parts of pairs. Each part of the graph that positive affinities connect is solved by itself: exactly if it has at
    most 16 detections and all such parts together at most 32, else camera by camera, which is exact for two cameras.
    ``affinities`` are symmetric, ``-inf`` for two detections that can't be the same person; ``groups`` are the cameras
    of detections, and a part has at most one detection of a camera.
    """
    mutual = _partition_by_best(affinities, groups)
    if mutual is not None:
        return Partition(mutual, is_exact=True)
    possible = (affinities > 0) & (groups[:, None] != groups[None, :])
    _, labels = connected_components(csr_array(possible), directed=False)
    parts: list[tuple[int, ...]] = []
    is_exact, left_nodes = True, _MAX_NODES
    for label in np.unique(labels):
        nodes = np.flatnonzero(labels == label)
        inside = affinities[np.ix_(nodes, nodes)], groups[nodes]
        solution = _partition_by_best(*inside)
        if solution is None and len(nodes) <= min(_MAX_PROGRAMME_NODES, left_nodes):
            left_nodes -= len(nodes)
            solution = _partition_connected(*inside)
        if solution is None:
            solution = _partition_camera_by_camera(*inside)
            is_exact &= len(np.unique(inside[1])) == 2
        parts.extend(tuple(nodes[list(part)].tolist()) for part in solution)
    return Partition(tuple(parts), is_exact)


def _partition_by_best(
    affinities: Float[np.ndarray, "nodes nodes"], groups: Int[np.ndarray, " nodes"]
) -> tuple[tuple[int, ...], ...] | None:
    """Solve eq. 14-16 if best partners are mutual: every node's best partner in every camera chooses that node, too.

    A node has at most one partner in a camera. So the sum of every node's best positive affinity to each camera bounds
    the gain of a partition. Parts in which all nodes are each other's best partners reach that bound. ``None`` if best
    partners are not mutual.
    """
    linked = np.eye(len(groups), dtype=bool)
    rows = np.arange(len(groups))
    for group in np.unique(groups):
        members = np.flatnonzero(groups == group)
        chosen = members[affinities[:, members].argmax(1)]
        linked[rows, chosen] |= (affinities[rows, chosen] > 0) & (groups != group)
    _, labels = connected_components(csr_array(linked), directed=False)
    if not np.array_equal(linked, labels[:, None] == labels):
        return None
    return _group_parts(labels)


def _partition_connected(
    affinities: Float[np.ndarray, "nodes nodes"], groups: Int[np.ndarray, " nodes"]
) -> tuple[tuple[int, ...], ...] | None:
    """Solve eq. 14-16 for one connected part of the graph; ``None`` if that takes too many branches."""
    num_nodes = len(groups)
    pairs = list(combinations(range(num_nodes), 2))
    variable = {pair: k for k, pair in enumerate(pairs)}
    gains = np.array([max(affinities[i, j], _NEVER) for i, j in pairs])
    upper = np.array([0.0 if groups[i] == groups[j] else 1.0 for i, j in pairs])

    rows: list[int] = []
    columns: list[int] = []
    values: list[float] = []
    num_constraints = 0
    for i, j, k in combinations(range(num_nodes), 3):
        triangle = (variable[i, j], variable[j, k], variable[i, k])
        for closing in triangle:
            for edge in triangle:
                rows.append(num_constraints)
                columns.append(edge)
                values.append(-1.0 if edge == closing else 1.0)
            num_constraints += 1
    consistency = LinearConstraint(
        csr_array((values, (rows, columns)), shape=(num_constraints, len(pairs))), -np.inf, 1.0
    )
    solution = milp(
        -gains,
        integrality=np.ones(len(pairs)),
        bounds=Bounds(0.0, upper),
        constraints=consistency,
        options={"node_limit": _MAX_BRANCHES},
    )
    if solution.status != 0:
        return None
    chosen = np.zeros((num_nodes, num_nodes), bool)
    for (i, j), value in zip(pairs, np.round(solution.x), strict=True):
        chosen[i, j] = value > 0
    _, labels = connected_components(csr_array(chosen), directed=False)
    return _group_parts(labels)


def _partition_camera_by_camera(
    affinities: Float[np.ndarray, "nodes nodes"], groups: Int[np.ndarray, " nodes"]
) -> tuple[tuple[int, ...], ...]:
    """Match the detections of each camera in turn to the parts so far (Hungarian algorithm)."""
    gains = np.maximum(affinities, _NEVER)
    labels = np.arange(len(groups))
    part_gains = np.zeros_like(gains)  # gain of each label's part with each node
    for group in np.unique(groups):
        members = np.flatnonzero(groups == group)
        parts = np.unique(labels[groups < group])
        for part, member in assign(part_gains[np.ix_(parts, members)]):
            labels[members[member]] = parts[part]
        part_gains[labels[members]] += gains[members]
    return _group_parts(labels)


def _group_parts(labels: Int[np.ndarray, " nodes"]) -> tuple[tuple[int, ...], ...]:
    """Group nodes by label, labels of a single node left out, in order of the first nodes."""
    in_order = np.argsort(labels, kind="stable")
    parts = np.split(in_order, np.flatnonzero(np.diff(labels[in_order])) + 1)
    return tuple(sorted(tuple(part.tolist()) for part in parts if len(part) >= 2))


# Most detections that are grouped at once: a hundred people in five cameras. The simulated scenes have 24.
_MAX_UNMATCHED = 512


@dataclass(frozen=True, slots=True, eq=False)
class Unmatched:
    """Detection of a camera's most recent frame that belongs to no target."""

    # Position of the camera, and row of the detection among all detections
    camera: int
    row: int
    time_s: float  # Time of the frame
    # Undistorted joints, NaN where not used, and the detector's confidence
    points_px: Float[np.ndarray, "joints 2"]
    score: Float[np.ndarray, " joints"]


class Groups(NamedTuple):
    """Unmatched detections grouped into people."""

    people: list[list[Unmatched]]  # Detections of each person, from at least two cameras
    is_exact: bool  # True if all detections were considered and the grouping is optimal


def epipolar_affinity(
    fundamental: Float[np.ndarray, "3 3"],
    left_px: Float[np.ndarray, "left joints 2"],
    right_px: Float[np.ndarray, "right joints 2"],
    alpha_px: float,
) -> Float[np.ndarray, "left right"]:
    """Affinity A_e of detections in two cameras (eq. 12-13).

    ``fundamental``: fundamental matrix of the left and the right camera; see ``geometry.epipolar``. ``left_px``,
    ``right_px``: undistorted pixels, NaN where a joint is unseen. ``alpha_px``: epipolar distance at which the affinity
    is 0. Returns a_e, a mean over shared joints; ``-inf`` for a pair that shares fewer than three joints. A joint's
    term is at least -1, so that a single wrong joint does not decide.
    """
    left, right = np.broadcast_arrays(left_px[:, None], right_px[None])
    terms = np.maximum(1 - epipolar_distance_px(fundamental, left, right) / alpha_px, -1.0)
    shared: Bool[np.ndarray, "left right joints"] = np.isfinite(terms)
    return mean_over_joints(np.where(shared, terms, 0.0), shared)


def mean_over_joints(
    terms: Float[np.ndarray, "*batch joints"], shared: Bool[np.ndarray, "*batch joints"]
) -> Float[np.ndarray, "*batch"]:
    """Mean of the shared joints' terms, the others being 0; ``-inf`` for too few shared joints."""
    count = shared.sum(-1)
    return np.where(count >= MIN_JOINTS, terms.sum(-1) / np.maximum(count, 1), -np.inf)


def ray_distance_m(
    points_m: Float[np.ndarray, "*#batch 3"],
    center_m: Float[np.ndarray, "*#batch 3"],
    rays: Float[np.ndarray, "*batch 3"],
) -> Float[np.ndarray, "*batch"]:
    """Distance d of points to unit rays from a camera centre (eq. 4).

    Distances are in metres; infinite for points behind the camera, NaN where an input is NaN.
    """
    offset_m = points_m - center_m
    along_m = (offset_m * rays).sum(-1)
    across_m = np.linalg.norm(offset_m - along_m[..., None] * rays, axis=-1)
    return np.where(along_m < 0, np.inf, across_m)


def group_unmatched(
    unmatched: Sequence[Unmatched], fundamentals: Float[np.ndarray, "cameras cameras 3 3"], alpha_px: float
) -> Groups:
    """Group detections of several cameras into people (eq. 12-16).

    Of more than 512 detections, those with the highest scores are grouped. ``fundamentals[left, right]`` are of
    ``geometry.epipolar.fundamental_matrices``; ``alpha_px`` is the threshold of the epipolar distance (eq. 13).
    """
    is_complete = len(unmatched) <= _MAX_UNMATCHED
    if not is_complete:
        ranked = np.argsort([-body.score.sum() for body in unmatched], kind="stable")
        unmatched = [unmatched[int(i)] for i in np.sort(ranked[:_MAX_UNMATCHED])]
    cameras = np.array([body.camera for body in unmatched])
    affinities = np.full((len(unmatched), len(unmatched)), -np.inf)
    for left in np.unique(cameras):
        for right in np.unique(cameras[cameras > left]):
            rows, columns = np.flatnonzero(cameras == left), np.flatnonzero(cameras == right)
            block = epipolar_affinity(
                fundamentals[left, right],
                np.array([unmatched[int(i)].points_px for i in rows]),
                np.array([unmatched[int(j)].points_px for j in columns]),
                alpha_px,
            )
            affinities[np.ix_(rows, columns)] = block
            affinities[np.ix_(columns, rows)] = block.T
    parts, is_exact = partition(affinities, cameras)
    return Groups([[unmatched[i] for i in part] for part in parts], is_complete and is_exact)


def spread_m(rig: RigGeometry, group: Sequence[Unmatched], xyz_m: Float[np.ndarray, "joints 3"]) -> float:
    """Median distance of a group's triangulated joints to their viewing rays in metres; infinite without any joint."""
    cameras = [body.camera for body in group]
    points_px = np.array([body.points_px for body in group])
    homogeneous = np.concatenate([points_px, np.ones_like(points_px[..., :1])], axis=-1)
    rays = homogeneous @ rig.world_ray_from_image[cameras].swapaxes(-1, -2)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    distances_m = ray_distance_m(xyz_m, rig.center_m[cameras][:, None], rays)
    known = distances_m[np.isfinite(distances_m)]
    return float(np.median(known)) if known.size else np.inf


def is_body(xyz_m: Float[np.ndarray, "joints 3"], spread_m: float, parameters: TrackingParameters) -> bool:
    """True if a triangulated group can be a person: enough joints, rays that meet, and the size of a body.

    Two people in the same epipolar plane satisfy the epipolar constraint. Their rays then mostly miss each other, or
    meet at points that make no body of plausible size. World positions are NaN where a joint was not located;
    ``spread_m`` comes from the function of this name.
    """
    known = np.isfinite(xyz_m[:, 0])
    if known.sum() < xyz_m.shape[0] // 3 or not spread_m < parameters.alpha_3d_m:
        return False
    extent_m = np.ptp(xyz_m[known], axis=0).max()
    return bool(0.25 < extent_m < 2.6)


class Lost(NamedTuple):
    """Confirmed targets without recent observations."""

    # Last positions and velocities, (targets, joints, 3); NaN where a joint was never located
    xyz_m: np.ndarray
    velocity_m_s: np.ndarray
    gap_s: np.ndarray  # Time since each target was last located, (targets,)


def find_returning(
    found_m: Sequence[Float[np.ndarray, "joints 3"]], lost: Lost, parameters: TrackingParameters
) -> dict[int, int]:
    """Match newly located bodies to lost targets (Hungarian algorithm on the detour).

    A hidden person may continue or stop on the way. So the centre of the body is expected between its last position and
    its position by linear motion. A detour of up to ``duplicate_m`` plus ``max_detour_m_s`` times the gap is allowed.
    World positions of each body's joints are NaN where a joint was not located. Returns the position of the lost target
    by position of the body, for the matched bodies.
    """
    if not len(found_m) or not len(lost.gap_s):
        return {}
    apart_m = np.array(found_m)[:, None] - lost.xyz_m[None]
    shared = np.isfinite(apart_m[..., 0])
    count = np.maximum(shared.sum(-1), 1)[..., None]
    apart_m = np.where(shared[..., None], apart_m, 0.0).sum(-2) / count
    velocity_m_s = np.where(shared[..., None], lost.velocity_m_s, 0.0).sum(-2) / count
    speed2 = (velocity_m_s**2).sum(-1)
    along_s = np.clip((apart_m * velocity_m_s).sum(-1) / np.where(speed2 > 0, speed2, 1.0), 0.0, lost.gap_s)
    detour_m = np.linalg.norm(apart_m - along_s[..., None] * velocity_m_s, axis=-1)
    affinities = 1 - detour_m / (parameters.duplicate_m + parameters.max_detour_m_s * lost.gap_s)
    return dict(assign(np.where(shared.sum(-1) >= MIN_JOINTS, affinities, -np.inf)))
