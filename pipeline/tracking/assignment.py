"""Who belongs to whom: Hungarian assignment, and graph partitioning as a binary integer programme."""

from itertools import combinations

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import Bounds, LinearConstraint, linear_sum_assignment, milp
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

# Stands for "never" in an affinity that a solver has to add up.
_NEVER = -1e3


def assign(affinities: Float[np.ndarray, "targets detections"]) -> list[tuple[int, int]]:
    """Pairs (target, detection) of the maximum total affinity (Hungarian algorithm); a pair needs a positive one."""
    gain = np.maximum(affinities, 0.0)
    rows, columns = linear_sum_assignment(gain, maximize=True)
    return [(int(i), int(j)) for i, j in zip(rows, columns, strict=True) if affinities[i, j] > 0]


def partition(
    affinities: Float[np.ndarray, "nodes nodes"], groups: Int[np.ndarray, " nodes"]
) -> tuple[tuple[int, ...], ...]:
    """Partition detections of several cameras into people (Chen et al. 2020, eq. 14-16).

    Maximises the sum of affinities within parts; cycle consistency ``y_ij + y_jk <= 1 + y_ik`` for all i, j, k makes
    parts of pairs. Solved exactly, one programme for each part of the graph that positive affinities connect.

    Parameters
    ----------
    affinities
        Symmetric; ``-inf`` where two detections can't be one person.
    groups
        The camera of each detection: a part has at most one of each.

    Returns
    -------
        Parts of at least two detections, each ascending.
    """
    beyond_dispute = _partition_by_best(affinities, groups)
    if beyond_dispute is not None:
        return beyond_dispute
    possible = (affinities > 0) & (groups[:, None] != groups[None, :])
    _, labels = connected_components(csr_array(possible), directed=False)
    parts: list[tuple[int, ...]] = []
    for label in np.unique(labels):
        nodes = np.flatnonzero(labels == label)
        inside = affinities[np.ix_(nodes, nodes)], groups[nodes]
        found = _partition_by_best(*inside)
        found = _partition_connected(*inside) if found is None else found
        parts.extend(tuple(nodes[list(part)].tolist()) for part in found)
    return tuple(parts)


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
    if not np.array_equal(linked, linked.T) or not np.array_equal(linked, linked @ linked):
        return None
    return tuple(tuple(np.flatnonzero(row).tolist()) for row in np.unique(linked, axis=0)[::-1] if row.sum() >= 2)


def _partition_connected(
    affinities: Float[np.ndarray, "nodes nodes"], groups: Int[np.ndarray, " nodes"]
) -> tuple[tuple[int, ...], ...]:
    """Solve eq. 14-16 for one connected part of the graph."""
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
    solution = milp(-gains, integrality=np.ones(len(pairs)), bounds=Bounds(0.0, upper), constraints=consistency)
    chosen = np.zeros((num_nodes, num_nodes), bool)
    for (i, j), value in zip(pairs, np.round(solution.x), strict=True):
        chosen[i, j] = value > 0
    _, labels = connected_components(csr_array(chosen), directed=False)
    parts = (tuple(np.flatnonzero(labels == label).tolist()) for label in np.unique(labels))
    return tuple(part for part in parts if len(part) >= 2)
