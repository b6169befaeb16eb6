"""Match of whole bodies across views: bodies whose joints meet in space show the same person.

An addition to the paper for detectors that give bodies. Rays of two joints meet by chance; rays of all joints of two
bodies do not.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.association.clustering.clustering_parameters import ClusteringParameters
from pipeline.association.clustering.instant.constraints import pose_length_error
from pipeline.association.clustering.instant.evidence import NOWHERE
from pipeline.association.clustering.instant.hypotheses import Candidates, views_that_meet
from pipeline.association.clustering.instant.work_limits import MAX_BODIES, MAX_PAIRS, WorkLimits
from pipeline.association.clustering.skeleton import LimbLengths, Skeleton
from pipeline.geometry.triangulation import DISPUTED_M, plane_rows, solve_normal

# Least number of joints that agree with certainty if two groups of bodies are one person: two are too few.
_LEAST_JOINTS = 1.5
# Probability with which a joint of different people's bodies agrees, and expected number of such pairs of bodies in two
# views below which bodies are one person.
_CHANCE, _MAX_COINCIDENCES = 0.05, 0.1
# Sine of the smallest angle of two rays at which the length of a limb counts: the error along rays is three times that
# across them.
_LEAST_SINE = 0.34
# Pairs of bodies that are triangulated at once; the normal equations of each take 2 KB.
_BLOCK = 2**12


class InstantBodies(NamedTuple):
    """Detected bodies of all views at an instant."""

    view: np.ndarray  # Position of the camera, (bodies,)
    # Row of the candidate of each joint, (bodies, joints); ``NOWHERE`` for a missing joint. Of several candidates of a
    # joint, the one with the highest score.
    candidate: np.ndarray


def collect_bodies(candidates: Candidates, num_joints: int) -> InstantBodies:
    """Gather the bodies of candidates, in order of their views; candidates without a body are left out."""
    rows = np.flatnonzero(candidates.body >= 0)
    rows = rows[np.argsort(candidates.score[rows], kind="stable")]
    kinds, number = np.unique(
        np.column_stack([candidates.view[rows], candidates.body[rows]]), axis=0, return_inverse=True
    )
    candidate = np.full((len(kinds), num_joints), NOWHERE)
    candidate[number.ravel(), candidates.joint[rows]] = rows  # the last one has the highest score
    return InstantBodies(kinds[:, 0], candidate)


def match_bodies(
    image_from_world: Float[np.ndarray, "cameras 3 4"],
    candidates: Candidates,
    bodies: InstantBodies,
    skeleton: Skeleton,
    lengths: LimbLengths,
    parameters: ClusteringParameters,
    limits: WorkLimits,
) -> Int[np.ndarray, "people cameras"]:
    """Match bodies across views: body of each person in each view, ``NOWHERE`` for none.

    Every person has bodies of at least two views. Bodies without a partner are left out, and all bodies if there are
    more than ``MAX_BODIES``.
    """
    num_cameras = len(image_from_world)
    if not limits.allows(len(bodies.view), MAX_BODIES):
        return np.empty((0, num_cameras), int)
    agreement = agree(image_from_world, candidates, bodies, skeleton, lengths, parameters, limits)
    group_of = join_bodies(agreement, least_agreement(candidates, bodies))
    groups, sizes = np.unique(group_of, return_counts=True)
    people = np.full((len(groups), num_cameras), NOWHERE)
    people[np.searchsorted(groups, group_of), bodies.view] = np.arange(len(group_of))
    return people[sizes >= 2]


def agree(
    image_from_world: Float[np.ndarray, "cameras 3 4"],
    candidates: Candidates,
    bodies: InstantBodies,
    skeleton: Skeleton,
    lengths: LimbLengths,
    parameters: ClusteringParameters,
    limits: WorkLimits,
) -> Float[np.ndarray, "bodies bodies"]:
    """Agreement of all pairs of bodies: positive for bodies of one person, minus infinity for bodies of one view.

    It is the sum over the joints that both bodies have. A joint counts by the lower of its two scores: fully where the
    two rays meet, not at ``DISPUTED_M`` from the triangulated point, and against the pair beyond it. A joint at a limb
    with an impossible length (eq. 3 with ``leniency``) counts against the pair, wherever its rays meet.

    With more than ``MAX_PAIRS`` pairs, some pairs of views are left out; see ``views_that_meet``.
    """
    rows = plane_rows(image_from_world[candidates.view], candidates.points_px[:, None])[:, 0]
    axes = image_from_world[candidates.view, 2]
    normal = rows.swapaxes(-1, -2) @ rows
    ray = np.cross(rows[:, 0, :3], rows[:, 1, :3])
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    counts = skeleton.sources[0] < 0  # a neck between the shoulders says nothing that they do not say
    first, second = np.nonzero(_meeting(image_from_world, bodies, limits))
    total = np.zeros((len(bodies.view), len(bodies.view)))
    for begin in range(0, len(first), _BLOCK):
        block = first[begin : begin + _BLOCK], second[begin : begin + _BLOCK]
        left, right = (bodies.candidate[numbers] for numbers in block)
        both = (left >= 0) & (right >= 0)
        xyz_m = np.where(both[..., None], solve_normal(normal[left] + normal[right]), np.nan)
        miss_m = np.fmax(*(_miss_m(rows[end], axes[end], xyz_m) for end in (left, right)))
        value = np.maximum(1.0 - (miss_m / DISPUTED_M) ** 2, -1.0)
        is_sharp = np.linalg.norm(np.cross(ray[left], ray[right]), axis=-1) > _LEAST_SINE
        error = pose_length_error(xyz_m, skeleton, lengths)
        value[is_sharp & (error > parameters.leniency * parameters.tau3)] = -1.0
        weight = np.where(both & ~np.isnan(value), np.minimum(candidates.score[left], candidates.score[right]), 0.0)
        weight[:, 0] *= not counts
        total[block] = (weight * np.nan_to_num(value)).sum(-1)
    return np.where(bodies.view[:, None] == bodies.view, -np.inf, total + total.T)


def _meeting(
    image_from_world: Float[np.ndarray, "cameras 3 4"], bodies: InstantBodies, limits: WorkLimits
) -> Bool[np.ndarray, "bodies bodies"]:
    """Pairs of bodies that are compared: bodies of different views, the earlier view first."""
    wanted = bodies.view[:, None] < bodies.view
    if not limits.allows(int(np.count_nonzero(wanted)), MAX_PAIRS):
        count = np.bincount(bodies.view, minlength=len(image_from_world))
        meeting = views_that_meet(image_from_world, np.triu(np.outer(count, count), 1))
        wanted &= meeting[bodies.view[:, None], bodies.view]
    return wanted


def _miss_m(
    rows: Float[np.ndarray, "*batch 2 4"], axis: Float[np.ndarray, "*batch 4"], xyz_m: Float[np.ndarray, "*batch 3"]
) -> Float[np.ndarray, "*batch"]:
    """Distance of points to viewing rays in metres; infinite behind the camera, NaN for NaN."""
    residual_m = (rows[..., :3] @ xyz_m[..., None])[..., 0] + rows[..., 3]
    depth = (axis[..., :3] * xyz_m).sum(-1) + axis[..., 3]
    return np.where(depth <= 0, np.inf, np.linalg.norm(residual_m, axis=-1))


def least_agreement(candidates: Candidates, bodies: InstantBodies) -> float:
    """Least agreement of two groups of bodies that are one person.

    So many joints must agree that chance is not expected to give such a pair of bodies among all pairs of two views. A
    joint counts as much as joints score in these views: detectors have scales of their own, and score low in bad light
    and for half-hidden people.
    """
    if not len(bodies.view):
        return np.inf
    views, count = np.unique(bodies.view, return_counts=True)
    usual_score = np.mean([candidates.score[candidates.view == view].mean() for view in views])
    num_pairs = float(np.median(np.outer(count, count)[np.triu_indices(len(views), 1)])) if len(views) > 1 else 1.0
    num_joints = math.log(num_pairs / _MAX_COINCIDENCES) / -math.log(_CHANCE)
    return float(usual_score) * max(_LEAST_JOINTS, num_joints)


def join_bodies(agreement: Float[np.ndarray, "bodies bodies"], least: float) -> Int[np.ndarray, " bodies"]:
    """Join bodies to groups, the two groups with the largest sum of agreement first; returns each body's group.

    All pairs count, so that a group is consistent around every cycle of views. Two groups with bodies of the same view
    never join, nor do groups whose agreement is not above ``least``.
    """
    total = agreement.copy()
    np.fill_diagonal(total, -np.inf)
    group = np.arange(len(total))
    while len(total):
        first, second = divmod(int(total.argmax()), len(total))
        if not total[first, second] > least:
            break
        total[first] += total[second]
        total[:, first] = total[first]
        total[first, first] = -np.inf
        total[second] = total[:, second] = -np.inf
        group[group == second] = first
    return group
