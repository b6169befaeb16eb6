"""Assignment of detections: Hungarian algorithm, and graph partitioning as a binary integer programme."""

from itertools import combinations
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import Bounds, LinearConstraint, linear_sum_assignment, milp
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

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
