"""3D joints from hypotheses: clusters, split by parent joints, and matched candidates (section 3.2.2)."""

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from pipeline.association.clustering.clustering_parameters import ClusteringParameters
from pipeline.association.clustering.instant import work_limits
from pipeline.association.clustering.instant.constraints import fits, length_error, nearly_fits
from pipeline.association.clustering.instant.evidence import NOWHERE, JointPoints, LimbEvidence
from pipeline.association.clustering.instant.hypotheses import Candidates, Hypotheses, meet, reprojection_px
from pipeline.association.clustering.instant.joints import refine
from pipeline.association.clustering.skeleton import LimbLengths, Skeleton
from pipeline.geometry.triangulation import plane_rows

# Most points of a cluster that are tried as its densest point; the refinement of eq. 4 corrects the choice.
_MAX_SEEDS = 128
# Pairs of a joint and a candidate whose distances are computed at once.
_BLOCK = 2**18


class _Draft(NamedTuple):
    """Draft of a joint: candidates of different views, initial position, parent joint and cluster."""

    candidates: list[int]
    seed_m: Float[np.ndarray, " 3"]
    parent: int
    cluster: int


class Joints(NamedTuple):
    """3D joints of all people and kinds at an instant."""

    points: JointPoints  # Kinds and positions of the joints
    # Row of the candidate behind a joint in each view, (joints, cameras); ``NOWHERE`` for no candidate
    candidate: np.ndarray

    def where(self, chosen: Bool[np.ndarray, " joints"] | Int[np.ndarray, " chosen"]) -> "Joints":
        """Select joints by a mask or by rows."""
        return Joints(JointPoints(*(values[chosen] for values in self.points)), self.candidate[chosen])

    def with_others(self, others: "Joints") -> "Joints":
        """Append other joints."""
        points = JointPoints(*(np.concatenate(pair) for pair in zip(self.points, others.points, strict=True)))
        return Joints(points, np.concatenate([self.candidate, others.candidate]))


def no_joints(num_cameras: int) -> Joints:
    """Make an empty set of joints."""
    nothing = np.empty((0, num_cameras), int)
    return Joints(JointPoints(np.empty(0, int), np.empty((0, 3)), nothing), nothing)


def find_joints(
    image_from_world: Float[np.ndarray, "cameras 3 4"],
    candidates: Candidates,
    evidence: LimbEvidence,
    skeleton: Skeleton,
    lengths: LimbLengths,
    parameters: ClusteringParameters,
    limits: work_limits.WorkLimits,
    known: Joints | None = None,
) -> Joints:
    """Find the 3D joints of all people, level by level of the skeleton (sections 3.2 and 3.3).

    ``candidates``: candidates of all joints. Of more than ``MAX_CANDIDATES`` candidates of a joint in a view, those
    with the highest scores are used. ``known``: joints that were found before. They are parents like others, their
    candidates are not used again, and they are the first joints of the result.
    """
    joints = no_joints(len(image_from_world)) if known is None else known
    certain = np.setdiff1d(_most_certain(candidates, limits), joints.candidate)
    for level in skeleton.levels:
        of_level = certain[np.isin(candidates.joint[certain], level)]
        here = candidates.where(of_level)
        hypotheses = meet(image_from_world, here, parameters.tau1_px, limits)
        drafts: list[_Draft] = []
        is_small = len(joints.points.joint) * len(hypotheses.pair) <= work_limits.MAX_DENSE
        for kinds in [level] if is_small else [[kind] for kind in level]:
            of_kinds = hypotheses.where(np.isin(here.joint[hypotheses.pair[:, 0]], kinds))
            is_parent = np.isin(joints.points.joint, [skeleton.parents[kind] for kind in kinds])
            parent = np.flatnonzero(is_small | is_parent)
            parents = joints.where(parent).points
            value = np.empty((0, len(of_kinds.pair)))
            if level != [0]:
                value = _agreement(here, of_kinds, parents, evidence, skeleton, lengths, parameters)
                chosen = np.any(value > -np.inf, axis=0)
                of_kinds, value = of_kinds.where(chosen), value[:, chosen]
            parent = np.append(parent, NOWHERE)
            drafts += [
                draft._replace(parent=int(parent[draft.parent]))
                for draft in _draft(
                    image_from_world, here, of_kinds, value, parents, skeleton, lengths, parameters, limits
                )
            ]
        located = _locate(image_from_world, here, drafts, joints.points, parameters.eps_m, limits)
        candidate = np.where(located.candidate >= 0, np.append(of_level, NOWHERE)[located.candidate], NOWHERE)
        joints = joints.with_others(located._replace(candidate=candidate))
    return joints


def _most_certain(candidates: Candidates, limits: work_limits.WorkLimits) -> Int[np.ndarray, " _"]:
    """Rows of the candidates with the highest scores, at most ``MAX_CANDIDATES`` of a joint in a view."""
    place = candidates.view * (candidates.joint.max(initial=0) + 1) + candidates.joint
    if limits.allows(int(np.bincount(place).max(initial=0)), work_limits.MAX_CANDIDATES):
        return np.arange(len(place))
    ranked = np.lexsort((-candidates.score, place))
    first = np.searchsorted(place[ranked], place[ranked])
    return np.sort(ranked[np.arange(len(ranked)) - first < work_limits.MAX_CANDIDATES])


def _agreement(
    candidates: Candidates,
    hypotheses: Hypotheses,
    parents: JointPoints,
    evidence: LimbEvidence,
    skeleton: Skeleton,
    lengths: LimbLengths,
    parameters: ClusteringParameters,
) -> Float[np.ndarray, "parents hypotheses"]:
    """Agreement of each hypothesis with each parent (eq. 2 and 3); minus infinity where a constraint is violated.

    Bone lengths come first because they are cheap: connectivity is computed for the remaining pairs.
    """
    joint = candidates.joint[hypotheses.pair[:, 0]]
    body = np.full((len(hypotheses.pair), parents.body.shape[1]), NOWHERE)
    np.put_along_axis(body, candidates.view[hypotheses.pair], candidates.body[hypotheses.pair], axis=1)
    points = JointPoints(joint, hypotheses.xyz_m, body)
    error = length_error(parents, points, skeleton, lengths)
    possible = error <= parameters.leniency * parameters.tau3
    score = evidence.connect(parents, points, possible) if parameters.use_connectivity else np.full(error.shape, np.nan)
    least = evidence.least[joint]
    allowed = possible & fits(score, least, error, parameters.tau3)
    chance = possible & nearly_fits(
        score, least, error, parameters.tau3, lengths.is_measured[joint], parameters.leniency
    )
    for kind in np.unique(joint):
        of_kind = joint == kind
        lonely = ~allowed[:, of_kind].any(-1)
        allowed[np.ix_(lonely, of_kind)] = chance[np.ix_(lonely, of_kind)]
    value = np.nan_to_num(score, nan=0.0) if parameters.use_connectivity else -error
    return np.where(allowed, value, -np.inf)


def _draft(
    image_from_world: Float[np.ndarray, "cameras 3 4"],
    candidates: Candidates,
    hypotheses: Hypotheses,
    value: Float[np.ndarray, "parents hypotheses"],
    parents: JointPoints,
    skeleton: Skeleton,
    lengths: LimbLengths,
    parameters: ClusteringParameters,
    limits: work_limits.WorkLimits,
) -> list[_Draft]:
    """Draft joints: cluster hypotheses, split clusters by parents, and match candidates across views in each."""
    unseen = np.full(len(image_from_world), NOWHERE)
    drafts: list[_Draft] = []
    joint = candidates.joint[hypotheses.pair[:, 0]]
    parent_of = value.argmax(0) if value.size else np.full(len(joint), NOWHERE)
    clusters = list(cluster_hypotheses(hypotheses.xyz_m, joint, parameters.eps_m, limits))
    may_split = parameters.split_clusters and value.size > 0
    outbid = _outbid(value, joint, parent_of, clusters) if may_split else {}
    for cluster, members in enumerate(clusters):
        shared = [(parent, members[value[parent, members] > -np.inf]) for parent in outbid.get(cluster, [])]
        if len(members) == 1:  # most clusters: rays that meet by chance
            parents_here = [int(parent_of[members[0]]), *(parent for parent, _ in shared)]
            used, seed_m = hypotheses.pair[members[0]].tolist(), hypotheses.xyz_m[members[0]]
            drafts.extend(_Draft(used, seed_m, parent, cluster) for parent in parents_here)
            continue
        groups = _split(
            hypotheses.xyz_m, members, int(joint[members[0]]), parent_of, parents, skeleton, lengths, parameters
        )
        for parent, group in (*groups, *shared):
            own = parents.body[parent] if parent >= 0 else unseen
            drafts.extend(
                _Draft(used, seed_m, parent, cluster)
                for used, seed_m in _extract(image_from_world, candidates, hypotheses, group, own, parameters, limits)
            )
    return drafts


def cluster_hypotheses(
    xyz_m: Float[np.ndarray, "hypotheses 3"],
    joint: Int[np.ndarray, " hypotheses"],
    eps_m: float,
    limits: work_limits.WorkLimits,
) -> Iterator[Int[np.ndarray, " _"]]:
    """Cluster hypotheses by DBSCAN with at least one sample: clusters are the connected components of neighbours.

    With more than ``MAX_NEIGHBOURS`` pairs of neighbours, points are replaced by the centres of cells half as wide as
    ``eps_m``.
    """
    if not len(xyz_m):
        return
    # Imported here: scikit-learn takes half a second and 30 MB, which processes that only track people are spared.
    from sklearn import config_context  # noqa: PLC0415
    from sklearn.cluster import DBSCAN  # noqa: PLC0415

    # A fourth dimension separates joints of different kinds.
    places = np.column_stack([xyz_m, 10 * eps_m * joint])
    cell_of = np.arange(len(places))
    if len(places) ** 2 > 2 * work_limits.MAX_NEIGHBOURS:
        tree = cKDTree(places)
        if not limits.allows(int(tree.count_neighbors(tree, eps_m)) // 2, work_limits.MAX_NEIGHBOURS):
            cells, cell_of = np.unique(np.floor(places / (eps_m / 2)), axis=0, return_inverse=True)
            places = (cells + 0.5) * (eps_m / 2)
    # The tree computes distances exactly and in one thread. Most sets are so small that checks of the input would take
    # longer than their clusters.
    with config_context(assume_finite=True, skip_parameter_validation=True):
        labels = DBSCAN(eps=eps_m, min_samples=1, algorithm="kd_tree").fit(places).labels_[cell_of]
    in_order = np.argsort(labels, kind="stable")
    yield from np.split(in_order, np.flatnonzero(np.diff(labels[in_order])) + 1)


def _split(
    xyz_m: Float[np.ndarray, "hypotheses 3"],
    members: Int[np.ndarray, " _"],
    joint: int,
    parent_of: Int[np.ndarray, " hypotheses"],
    parents: JointPoints,
    skeleton: Skeleton,
    lengths: LimbLengths,
    parameters: ClusteringParameters,
) -> Iterator[tuple[int, Int[np.ndarray, " _"]]]:
    """Split a cluster by the parents of its members if its centre fits several parents: joints of people who touch."""
    wanted, counts = np.unique(parent_of[members], return_counts=True)
    if len(wanted) < 2 or not parameters.split_clusters:
        yield int(wanted[counts.argmax()]), members
        return
    centre = JointPoints(np.array([joint]), xyz_m[members].mean(0, keepdims=True), parents.body[:1])
    error = length_error(JointPoints(*(values[wanted] for values in parents)), centre, skeleton, lengths)
    if (error <= parameters.tau3).sum() < 2:
        yield int(wanted[counts.argmax()]), members
        return
    for parent in wanted.tolist():
        yield parent, members[parent_of[members] == parent]


def _outbid(
    value: Float[np.ndarray, "parents hypotheses"],
    joint: Int[np.ndarray, " hypotheses"],
    parent_of: Int[np.ndarray, " hypotheses"],
    clusters: Sequence[Int[np.ndarray, " _"]],
) -> dict[int, list[int]]:
    """Parents that are the best parent of no hypothesis of a joint, by the number of their best cluster.

    Clapping hands are a single peak in most views and a single point in space, which belongs to both people.
    """
    cluster_of = np.empty(len(joint), int)
    for number, members in enumerate(clusters):
        cluster_of[members] = number
    by_cluster: dict[int, list[int]] = {}
    for kind in np.unique(joint):
        of_kind = np.flatnonzero(joint == kind)
        could = np.any(value[:, of_kind] > -np.inf, axis=1)
        could[parent_of[of_kind]] = False
        for parent in np.flatnonzero(could).tolist():
            best = of_kind[value[parent, of_kind].argmax()]
            by_cluster.setdefault(int(cluster_of[best]), []).append(parent)
    return by_cluster


def _extract(
    image_from_world: Float[np.ndarray, "cameras 3 4"],
    candidates: Candidates,
    hypotheses: Hypotheses,
    members: Int[np.ndarray, " _"],
    parent_body: Int[np.ndarray, " cameras"],
    parameters: ClusteringParameters,
    limits: work_limits.WorkLimits,
) -> Iterator[tuple[list[int], Float[np.ndarray, " 3"]]]:
    """Extract joints from a group of hypotheses: matched candidates of different views, and an initial position.

    Each round takes the densest point and the best candidate of each view near it: a candidate of the parent's body
    first, then the nearest. Hypotheses that use none of these candidates remain for the next round. Once the work of
    an instant is spent, the remaining hypotheses give a single joint.
    """
    if not parameters.separate_clusters:
        yield _match(candidates, hypotheses, members)
        return
    while len(members):
        if not limits.allows_round(len(members)):
            yield _match(candidates, hypotheses, members)
            return
        xyz_m, pair = hypotheses.xyz_m[members], hypotheses.pair[members]
        seeds_m = xyz_m[:: -(-len(xyz_m) // _MAX_SEEDS)]
        squared_m2 = cdist(seeds_m, xyz_m, "sqeuclidean")
        density = np.exp(squared_m2 * (-0.5 / (parameters.eps_m / 3) ** 2)).sum(-1)
        seed_m = seeds_m[density.argmax()]
        used = np.unique(pair)
        views = candidates.view[used]
        errors_px = reprojection_px(
            image_from_world[views], np.broadcast_to(seed_m, (len(used), 3)), candidates.points_px[used]
        )
        candidate = np.full(len(image_from_world), NOWHERE)
        is_strange = (parent_body[views] >= 0) & (candidates.body[used] != parent_body[views])
        in_order = np.lexsort((-errors_px, ~is_strange))  # the best candidate of a view comes last
        in_order = in_order[errors_px[in_order] <= 2 * parameters.tau1_px]
        candidate[views[in_order]] = used[in_order]
        candidate = candidate[candidate >= 0]
        yield candidate.tolist(), seed_m
        members = members[~(pair[:, :, None] == candidate).any((1, 2))]


def _match(
    candidates: Candidates, hypotheses: Hypotheses, members: Int[np.ndarray, " _"]
) -> tuple[list[int], Float[np.ndarray, " 3"]]:
    """Match the candidates of one joint as in the paper: in each view the candidate of the most hypotheses."""
    used, counts = np.unique(hypotheses.pair[members], return_counts=True)
    in_order = used[np.lexsort((candidates.score[used], counts))]  # the best candidate of a view comes last
    of_view = dict(zip(candidates.view[in_order].tolist(), in_order.tolist(), strict=True))
    return list(of_view.values()), np.median(hypotheses.xyz_m[members], axis=0)


def _locate(
    image_from_world: Float[np.ndarray, "cameras 3 4"],
    candidates: Candidates,
    drafts: list[_Draft],
    parents: JointPoints,
    eps_m: float,
    limits: work_limits.WorkLimits,
) -> Joints:
    """Assign each candidate to one draft, drafts with the most views first, and locate drafts that keep two views.

    Of more than ``MAX_JOINTS`` drafts of a kind, those with the most views are located.

    Drafts of different parents from a split cluster may share a candidate: two people's joints may be one peak in a
    view. Unused candidates go to a nearby joint that lacks their view.
    """
    score = candidates.score.tolist()
    drafts = sorted(drafts, key=lambda draft: (-len(draft.candidates), -sum(score[k] for k in draft.candidates)))
    owners: dict[int, list[_Draft]] = {}
    kept: list[_Draft] = []
    num_kept: Counter[int] = Counter()
    for draft in drafts:
        left = [k for k in draft.candidates if k not in owners or _may_share(draft, owners[k])]
        kind = int(candidates.joint[draft.candidates[0]])
        if len(left) >= 2 and limits.allows(num_kept[kind] + 1, work_limits.MAX_JOINTS):
            num_kept[kind] += 1
            kept.append(draft._replace(candidates=left))
            for k in left:
                owners.setdefault(k, []).append(draft)
    if not kept:
        return no_joints(len(image_from_world))
    chosen = np.full((len(kept), len(image_from_world)), NOWHERE)
    for row, draft in enumerate(kept):
        chosen[row, candidates.view[draft.candidates]] = draft.candidates
    confidence = np.append(candidates.score, 0.0)
    points_px = np.append(candidates.points_px, [[0.0, 0.0]], axis=0)
    seeds_m = np.array([draft.seed_m for draft in kept])
    xyz_m = refine(image_from_world, seeds_m, points_px[chosen], confidence[chosen])
    if adopt(image_from_world, candidates, xyz_m, chosen, eps_m):
        xyz_m = refine(image_from_world, xyz_m, points_px[chosen], confidence[chosen])
    body = np.append(candidates.body, NOWHERE)[chosen]
    if kept[0].parent != NOWHERE:
        body = np.where(body >= 0, body, parents.body[[draft.parent for draft in kept]])
    return Joints(JointPoints(candidates.joint[chosen.max(-1)], xyz_m, body), chosen)


def _may_share(draft: _Draft, owners: list[_Draft]) -> bool:
    """Return whether a draft may share a candidate with its owners: the same cluster, and different parents."""
    return all(owner.cluster == draft.cluster and owner.parent != draft.parent for owner in owners)


def adopt(
    image_from_world: Float[np.ndarray, "cameras 3 4"],
    candidates: Candidates,
    xyz_m: Float[np.ndarray, "joints 3"],
    chosen: Int[np.ndarray, "joints cameras"],
    eps_m: float,
) -> bool:
    """Assign unused candidates to the joint nearest to their ray that lacks their view; changes ``chosen``.

    Such a candidate met no other candidate within tau1, because of noise or an inaccurate calibration, but is within
    the spread of a joint. Without it, the reprojection error of the joint would be too small. Returns whether any
    candidate was assigned.
    """
    free = np.setdiff1d(np.arange(len(candidates.view)), chosen)
    view = candidates.view[free]
    joint = candidates.joint[chosen.max(-1)]
    wanted = (joint[:, None] == candidates.joint[free]) & (chosen[:, view] == NOWHERE)
    number, which = np.nonzero(wanted)
    rows = plane_rows(image_from_world[view], candidates.points_px[free][:, None])[:, 0]
    miss_m = np.empty(len(number))
    for block in (slice(start, start + _BLOCK) for start in range(0, len(number), _BLOCK)):
        joint_m, planes = xyz_m[number[block]], rows[which[block]]
        miss_m[block] = np.linalg.norm((planes[..., :3] @ joint_m[..., None])[..., 0] + planes[..., 3], axis=-1)
    near = np.flatnonzero(miss_m <= eps_m)
    taken: set[int] = set()
    for k in near[np.argsort(miss_m[near], kind="stable")].tolist():
        candidate = int(free[which[k]])
        if candidate not in taken and chosen[number[k], view[which[k]]] == NOWHERE:
            taken.add(candidate)
            chosen[number[k], view[which[k]]] = candidate
    return bool(taken)
