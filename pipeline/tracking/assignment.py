"""Who belongs to whom: Hungarian assignment, and graph partitioning as a binary integer programme."""

from itertools import combinations
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import Bounds, LinearConstraint, linear_sum_assignment, milp
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

# Stands for "never" in an affinity that a solver has to add up.
_NEVER = -1e3
# The programme of so many detections takes up to a second; its constraints grow with their third power. Connected parts
# of the simulated scenes have 13 at most.
_MAX_PROGRAMME_NODES = 16
# Of all programmes of a partition together.
_MAX_NODES = 32
# Of the branch and bound tree of a programme; those of the simulated scenes are solved at its root.
_MAX_BRANCHES = 1000


class Partition(NamedTuple):
    """Detections of several cameras as people.

    Parameters
    ----------
    parts
        Detections of each person, at least two, ascending.
    is_exact
        Whether no other partition is better; else some parts were matched camera by camera.
    """

    parts: tuple[tuple[int, ...], ...]
    is_exact: bool


def assign(affinities: Float[np.ndarray, "targets detections"]) -> list[tuple[int, int]]:
    """Pairs (target, detection) of the maximum total affinity (Hungarian algorithm); a pair needs a positive one."""
    gain = np.maximum(affinities, 0.0)
    rows, columns = linear_sum_assignment(gain, maximize=True)
    return [(int(i), int(j)) for i, j in zip(rows, columns, strict=True) if affinities[i, j] > 0]


def partition(affinities: Float[np.ndarray, "nodes nodes"], groups: Int[np.ndarray, " nodes"]) -> Partition:
    """Partition detections of several cameras into people (Chen et al. 2020, eq. 14-16).

    Maximises the sum of affinities within parts; cycle consistency ``y_ij + y_jk <= 1 + y_ik`` for all i, j, k makes
    parts of pairs. Each part of the graph that positive affinities connect is solved by itself: exactly where it has
    16 detections at most, and such parts together 32; else camera by camera, which is exact for two cameras.

    Parameters
    ----------
    affinities
        Symmetric; ``-inf`` where two detections can't be one person.
    groups
        The camera of each detection: a part has at most one of each.
    """
    beyond_dispute = _partition_by_best(affinities, groups)
    if beyond_dispute is not None:
        return Partition(beyond_dispute, is_exact=True)
    possible = (affinities > 0) & (groups[:, None] != groups[None, :])
    _, labels = connected_components(csr_array(possible), directed=False)
    parts: list[tuple[int, ...]] = []
    is_exact, left_nodes = True, _MAX_NODES
    for label in np.unique(labels):
        nodes = np.flatnonzero(labels == label)
        inside = affinities[np.ix_(nodes, nodes)], groups[nodes]
        found = _partition_by_best(*inside)
        if found is None and len(nodes) <= min(_MAX_PROGRAMME_NODES, left_nodes):
            left_nodes -= len(nodes)
            found = _partition_connected(*inside)
        if found is None:
            found = _partition_camera_by_camera(*inside)
            is_exact &= len(np.unique(inside[1])) == 2
        parts.extend(tuple(nodes[list(part)].tolist()) for part in found)
    return Partition(tuple(parts), is_exact)


def _partition_by_best(
    affinities: Float[np.ndarray, "nodes nodes"], groups: Int[np.ndarray, " nodes"]
) -> tuple[tuple[int, ...], ...] | None:
    """The solution of eq. 14-16 where every node's best partner in every other camera is beyond dispute, else ``None``.

    A node has at most one partner in a camera. So no partition gains more than the sum of every node's best positive
    affinity to each camera; parts in which all are each other's best gain just that, and are the solution.
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
    return _parts_of(labels)


def _partition_connected(
    affinities: Float[np.ndarray, "nodes nodes"], groups: Int[np.ndarray, " nodes"]
) -> tuple[tuple[int, ...], ...] | None:
    """Solve eq. 14-16 for one connected part of the graph; ``None`` where that takes too many branches."""
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
    return _parts_of(labels)


def _partition_camera_by_camera(
    affinities: Float[np.ndarray, "nodes nodes"], groups: Int[np.ndarray, " nodes"]
) -> tuple[tuple[int, ...], ...]:
    """Match the detections of each camera in turn to the parts so far, for the largest sum (Hungarian algorithm)."""
    gains = np.maximum(affinities, _NEVER)
    labels = np.arange(len(groups))
    part_gains = np.zeros_like(gains)  # of the part of each label with each node
    for group in np.unique(groups):
        members = np.flatnonzero(groups == group)
        parts = np.unique(labels[groups < group])
        for part, member in assign(part_gains[np.ix_(parts, members)]):
            labels[members[member]] = parts[part]
        part_gains[labels[members]] += gains[members]
    return _parts_of(labels)


def _parts_of(labels: Int[np.ndarray, " nodes"]) -> tuple[tuple[int, ...], ...]:
    """Nodes of each label that at least two have, in order of their first nodes."""
    in_order = np.argsort(labels, kind="stable")
    parts = np.split(in_order, np.flatnonzero(np.diff(labels[in_order])) + 1)
    return tuple(sorted(tuple(part.tolist()) for part in parts if len(part) >= 2))
