"""Hypotheses to joints: clusters, merged ones split by their parents (section 3.2.2)."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from pipeline.clustering.bone_lengths import LimbLengths
from pipeline.clustering.constraints import SECOND_CHANCE, is_connected, length_error, membership
from pipeline.clustering.hypotheses import Candidates, Hypotheses, meet, reprojection_px
from pipeline.clustering.joints import refine
from pipeline.clustering.parameters import ClusteringParameters
from pipeline.clustering.skeleton import Skeleton

NOWHERE = -1

# A view's candidate each, where they meet, and the parent.
_Draft = tuple[Int[np.ndarray, " cameras"], Float[np.ndarray, " 3"], int]


class Joints(NamedTuple):
    """Everybody's joints at an instant, of any kind.

    Parameters
    ----------
    joint
        Which joint of the skeleton, (joints,).
    xyz_m
        (joints, 3).
    is_seen
        Whether a view has a candidate behind the joint, (joints, cameras).
    body
        The detection behind the joint in each view, or behind its ancestors where it has none itself, (joints,
        cameras), ``NOWHERE`` where nobody knows.
    """

    joint: np.ndarray
    xyz_m: np.ndarray
    is_seen: np.ndarray
    body: np.ndarray

    def of(self, joint: int) -> "Joints":
        """Those of one kind."""
        chosen = self.joint == joint
        return Joints(*(values[chosen] for values in self))

    def with_others(self, others: "Joints") -> "Joints":
        """All of both."""
        return Joints(*(np.concatenate(pair) for pair in zip(self, others, strict=True)))


def no_joints(num_cameras: int) -> Joints:
    """Nobody has one."""
    return Joints(np.empty(0, int), np.empty((0, 3)), np.empty((0, num_cameras), bool), np.empty((0, num_cameras), int))


def find_joints(
    image_from_world: Float[np.ndarray, "cameras 3 4"],
    candidates: Candidates,
    skeleton: Skeleton,
    lengths: LimbLengths,
    parameters: ClusteringParameters,
) -> Joints:
    """Find everybody's joints, those together that are as far from the root as each other.

    Parameters
    ----------
    candidates
        Of all joints.
    """
    found = no_joints(len(image_from_world))
    for level in skeleton.levels:
        here = candidates.of(level)
        hypotheses = meet(image_from_world, here, parameters.tau1_px)
        parent_of = np.full(len(hypotheses.pair), NOWHERE)
        if level != [0]:
            score, allowed = _agree(here, hypotheses, found, skeleton, lengths, parameters)
            chosen = np.any(allowed, axis=0)
            hypotheses = hypotheses.where(chosen)
            if len(hypotheses.pair):
                parent_of = np.where(allowed, np.nan_to_num(score, nan=0.0), -1.0)[:, chosen].argmax(0)
        drafts: list[_Draft] = []
        for members in _clusters(hypotheses.xyz_m, here.joint[hypotheses.pair[:, 0]], parameters.eps_m):
            joint = int(here.joint[hypotheses.pair[members[0], 0]])
            for group in _split(hypotheses.xyz_m, members, joint, parent_of, found, lengths, parameters):
                votes, counts = np.unique(parent_of[group], return_counts=True)
                parent = int(votes[counts.argmax()])
                own = found.body[parent] if parent >= 0 else np.full(len(image_from_world), NOWHERE)
                drafts.extend(
                    (candidate, seed_m, parent)
                    for candidate, seed_m in _extract(image_from_world, here, hypotheses, group, own, parameters)
                )
        found = found.with_others(_locate(image_from_world, here, drafts, found))
    return found


def _agree(
    candidates: Candidates,
    hypotheses: Hypotheses,
    parents: Joints,
    skeleton: Skeleton,
    lengths: LimbLengths,
    parameters: ClusteringParameters,
) -> tuple[Float[np.ndarray, "parents hypotheses"], Bool[np.ndarray, "parents hypotheses"]]:
    """Connectivity with every parent, and which parents each hypothesis may hang on (eq. 2 and 3)."""
    joint = candidates.joint[hypotheses.pair[:, 0]]
    body = np.full((len(hypotheses.pair), parents.body.shape[1]), NOWHERE)
    np.put_along_axis(body, candidates.view[hypotheses.pair], candidates.body[hypotheses.pair], axis=1)
    score = membership(parents.body, body)
    is_limb = parents.joint[:, None] == np.array(skeleton.parents)[joint]
    connected = is_limb & is_connected(score, parameters.tau2)
    error = length_error(parents.xyz_m, hypotheses.xyz_m, joint, lengths)
    allowed = connected & (error <= parameters.tau3)
    # Two views alone are less exact than the joint will be: who would lose it gets a second chance.
    chance = connected & (error <= SECOND_CHANCE * parameters.tau3)
    for kind in np.unique(joint):
        of_kind = joint == kind
        lonely = ~allowed[:, of_kind].any(-1)
        allowed[np.ix_(lonely, of_kind)] = chance[np.ix_(lonely, of_kind)]
    return score, allowed


def _clusters(
    xyz_m: Float[np.ndarray, "hypotheses 3"], joint: Int[np.ndarray, " hypotheses"], eps_m: float
) -> Iterator[Int[np.ndarray, " _"]]:
    """DBSCAN with one sample to a cluster: every point is a core point then, and clusters are connected components."""
    if not len(xyz_m):
        return
    # Far apart in a fourth dimension, joints of different kinds have no neighbours in common.
    places = np.column_stack([xyz_m, 10 * eps_m * joint])
    pairs = cKDTree(places).query_pairs(eps_m, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs), bool), (pairs[:, 0], pairs[:, 1])), shape=(len(places), len(places)))
    _, labels = connected_components(graph, directed=False)
    in_order = np.argsort(labels, kind="stable")
    yield from np.split(in_order, np.flatnonzero(np.diff(labels[in_order])) + 1)


def _split(
    xyz_m: Float[np.ndarray, "hypotheses 3"],
    members: Int[np.ndarray, " _"],
    joint: int,
    parent_of: Int[np.ndarray, " hypotheses"],
    parents: Joints,
    lengths: LimbLengths,
    parameters: ClusteringParameters,
) -> Iterator[Int[np.ndarray, " _"]]:
    """Regroup by parent a cluster whose centre may hang on several: joints of people who touch."""
    wanted = np.unique(parent_of[members])
    if len(wanted) < 2 or not parameters.split_clusters:
        yield members
        return
    centre_m = xyz_m[members].mean(0, keepdims=True)
    error = length_error(parents.xyz_m[wanted], centre_m, np.array([joint]), lengths)
    if (error <= parameters.tau3).sum() < 2:
        yield members
        return
    for parent in wanted:
        yield members[parent_of[members] == parent]


def _extract(
    image_from_world: Float[np.ndarray, "cameras 3 4"],
    candidates: Candidates,
    hypotheses: Hypotheses,
    members: Int[np.ndarray, " _"],
    parent_body: Int[np.ndarray, " cameras"],
    parameters: ClusteringParameters,
) -> Iterator[tuple[Int[np.ndarray, " cameras"], Float[np.ndarray, " 3"]]]:
    """Candidates of one joint, a view each, from where hypotheses are densest; what uses none of them goes on.

    Of a view's candidates the one that is connected to the parent is taken, then the nearest.
    """
    if len(members) == 1:  # by far the most are chance meetings
        candidate = np.full(len(image_from_world), NOWHERE)
        candidate[candidates.view[hypotheses.pair[members[0]]]] = hypotheses.pair[members[0]]
        yield candidate, hypotheses.xyz_m[members[0]]
        return
    while len(members):
        xyz_m, pair = hypotheses.xyz_m[members], hypotheses.pair[members]
        apart_m = xyz_m[:, None] - xyz_m
        density = np.exp((apart_m * apart_m).sum(-1) * (-0.5 / (parameters.eps_m / 3) ** 2)).sum(-1)
        seed_m = xyz_m[density.argmax()]
        used = np.unique(pair)
        views = candidates.view[used]
        errors_px = reprojection_px(
            image_from_world[views], np.broadcast_to(seed_m, (len(used), 3)), candidates.points_px[used]
        )
        candidate = np.full(len(image_from_world), NOWHERE)
        is_strange = (parent_body[views] >= 0) & (candidates.body[used] != parent_body[views])
        in_order = np.lexsort((-errors_px, ~is_strange))  # the best of a view last
        in_order = in_order[errors_px[in_order] <= 2 * parameters.tau1_px]
        candidate[views[in_order]] = used[in_order]
        yield candidate, seed_m
        members = members[~(pair[:, :, None] == candidate).any((1, 2))]


def _locate(
    image_from_world: Float[np.ndarray, "cameras 3 4"],
    candidates: Candidates,
    drafts: list[_Draft],
    parents: Joints,
) -> Joints:
    """Give every candidate to one joint, the best supported first, and locate those that keep two views."""
    num_cameras = len(image_from_world)
    confidence = np.append(candidates.score, 0.0)
    drafts = sorted(drafts, key=lambda one: (-(one[0] >= 0).sum(), -confidence[one[0]].sum()))
    is_free = np.append(np.ones(len(candidates.score), bool), False)
    kept, seeds_m, parent_of = [], [], []
    for candidate, seed_m, parent in drafts:
        left = np.where(is_free[candidate], candidate, NOWHERE)
        if (left >= 0).sum() >= 2:
            is_free[left] = False
            kept.append(left)
            seeds_m.append(seed_m)
            parent_of.append(parent)
    if not kept:
        return no_joints(num_cameras)
    chosen = np.array(kept)
    points_px = np.append(candidates.points_px, [[0.0, 0.0]], axis=0)[chosen]
    xyz_m = refine(image_from_world, np.array(seeds_m), points_px, confidence[chosen])
    body = np.append(candidates.body, NOWHERE)[chosen]
    if parent_of[0] != NOWHERE:
        body = np.where(body >= 0, body, parents.body[parent_of])
    return Joints(candidates.joint[chosen.max(-1)], xyz_m, chosen >= 0, body)
