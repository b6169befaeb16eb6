"""People from matched bodies: joints are located from all views, and bodies that a detector mixed up are repaired."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from pipeline.association.clustering.clustering_parameters import ClusteringParameters
from pipeline.association.clustering.instant.bodies import collect_bodies, match_bodies
from pipeline.association.clustering.instant.clusters import Joints, adopt, no_joints
from pipeline.association.clustering.instant.constraints import pose_length_error
from pipeline.association.clustering.instant.evidence import NOWHERE, JointPoints
from pipeline.association.clustering.instant.hypotheses import Candidates
from pipeline.association.clustering.instant.joints import refine
from pipeline.association.clustering.instant.work_limits import MAX_REPAIRS, WorkLimits
from pipeline.association.clustering.skeleton import LimbLengths, Skeleton
from pipeline.geometry.triangulation import DISPUTED_M, plane_rows, triangulate_robust

# Distance of a joint from the ray of a candidate beyond which the candidate shows something else.
_FARTHEST_M = 0.15
# Relative error of a limb beyond which its outer joint is left out: no noise of a detector explains it.
_LARGEST_ERROR = 0.4
# Least number of joints of a person. Chance was excluded when the bodies were matched.
_LEAST_JOINTS = 3
# Least gain of a repair, in joints; a smaller gain may be noise.
_LEAST_GAIN = 0.3
_MAX_ROUNDS = 4
# Views of poses that are located at once; each takes about 10 KB.
_BLOCK = 2**14

_ARM, _LEG = ("shoulder", "elbow", "wrist"), ("hip", "knee", "ankle")


class MatchedPeople(NamedTuple):
    """People found from whole bodies."""

    # The people's joints. ``body`` is the person's body in each view, also for joints that another body shows.
    joints: Joints
    joint_of: np.ndarray  # Row of each person's joints in ``joints``, (people, joints); ``NOWHERE`` for a missing joint


class _Repair(NamedTuple):
    """Change of one person's joints in one view: joints ``to`` get the candidates of ``source``, or none."""

    to: list[int]
    source: list[int] | None


@dataclass(frozen=True, slots=True, eq=False)
class _Sight:
    """Viewing rays of all candidates; the last row stands for no candidate, so that ``NOWHERE`` selects it."""

    image_from_world: Float[np.ndarray, "cameras 3 4"]
    points_px: Float[np.ndarray, "rows 2"]
    score: Float[np.ndarray, " rows"]
    planes: Float[np.ndarray, "rows 2 4"]
    skeleton: Skeleton

    def locate(self, candidate: Int[np.ndarray, "poses joints cameras"]) -> Float[np.ndarray, "poses joints 3"]:
        """Locate joints robustly, NaN with fewer than two candidates."""
        by_view = candidate.swapaxes(1, 2)
        return self.with_neck(triangulate_robust(self.image_from_world, self.points_px[by_view], self.score[by_view]))

    def with_neck(self, xyz_m: Float[np.ndarray, "poses joints 3"]) -> Float[np.ndarray, "poses joints 3"]:
        """Put a neck that the detector lacks between the shoulders; changes ``xyz_m``."""
        if self.skeleton.sources[0] < 0:
            xyz_m[:, 0] = xyz_m[:, self.skeleton.shoulders].mean(1)
        return xyz_m

    def miss_m(
        self, xyz_m: Float[np.ndarray, "poses joints 3"], candidate: Int[np.ndarray, "poses joints cameras"]
    ) -> Float[np.ndarray, "poses joints cameras"]:
        """Distance of joints to the rays of their candidates in metres, NaN where either is missing."""
        planes = self.planes[candidate]
        residual_m = (planes[..., :3] @ xyz_m[:, :, None, :, None])[..., 0] + planes[..., 3]
        return np.linalg.norm(residual_m, axis=-1)


def _sight(image_from_world: Float[np.ndarray, "cameras 3 4"], candidates: Candidates, skeleton: Skeleton) -> _Sight:
    planes = plane_rows(image_from_world[candidates.view], candidates.points_px[:, None])[:, 0]
    return _Sight(
        image_from_world,
        np.append(candidates.points_px, [[np.nan, np.nan]], axis=0),
        np.append(candidates.score, 0.0),
        np.append(planes, np.full((1, 2, 4), np.nan), axis=0),
        skeleton,
    )


def match_people(
    image_from_world: Float[np.ndarray, "cameras 3 4"],
    candidates: Candidates,
    skeleton: Skeleton,
    lengths: LimbLengths,
    parameters: ClusteringParameters,
    limits: WorkLimits,
) -> MatchedPeople:
    """Find people from bodies that agree in several views; no person for candidates without bodies.

    A joint counts for the person that it agrees with in space, whatever body it is part of.
    """
    bodies = collect_bodies(candidates, len(skeleton.names))
    matched = match_bodies(image_from_world, candidates, bodies, skeleton, lengths, parameters, limits)
    if not len(matched):
        return MatchedPeople(no_joints(len(image_from_world)), np.empty((0, len(skeleton.names)), int))
    sight = _sight(image_from_world, candidates, skeleton)
    unseen = np.full((1, len(skeleton.names)), NOWHERE)
    candidate = np.append(bodies.candidate, unseen, axis=0)[matched].swapaxes(1, 2).copy()
    _repair(sight, candidate, lengths, parameters, limits)
    xyz_m = _share(sight, _renamed(candidates, candidate), candidate, parameters.eps_m)
    known = np.isfinite(xyz_m[..., 0])
    known &= ~(pose_length_error(xyz_m, skeleton, lengths) > _LARGEST_ERROR)
    known &= (known[:, skeleton.core_observed].sum(-1) >= _LEAST_JOINTS)[:, None]
    person, joint = np.nonzero(known)
    body_of = np.append(candidates.body, NOWHERE)[bodies.candidate.max(-1, initial=NOWHERE)]
    of_people = np.append(body_of, NOWHERE)[matched]
    joint_of = np.full(known.shape, NOWHERE)
    joint_of[known] = np.arange(len(person))
    points = JointPoints(joint, xyz_m[known], of_people[person])
    return MatchedPeople(Joints(points, candidate[known]), joint_of[known.any(-1)])


def _repair(
    sight: _Sight,
    candidate: Int[np.ndarray, "people joints cameras"],
    lengths: LimbLengths,
    parameters: ClusteringParameters,
    limits: WorkLimits,
) -> None:
    """Exchange left and right limbs in a view, or leave a limb of a view out, where this makes a better pose.

    Each round makes the best change of each person; changes ``candidate``. Only limbs that do not agree yet are tried.
    Beyond ``MAX_REPAIRS`` views of tried poses, the rest is not tried.
    """
    repairs = _repairs(sight.skeleton)
    for _ in range(_MAX_ROUNDS):
        value, is_doubtful = _value(sight, candidate, lengths, parameters)
        tried = [
            (person, number, view)
            for number, repair in enumerate(repairs)
            for person in np.flatnonzero(is_doubtful[:, repair.to].any(-1)).tolist()
            for view in np.flatnonzero((candidate[person, repair.to] >= 0).any(0)).tolist()
        ]
        if not tried:
            return
        most = MAX_REPAIRS // candidate.shape[-1]
        if not limits.allows(len(tried), most):
            tried = tried[:most]
        person, number, view = np.array(tried).T
        gain = np.empty(len(tried))
        size = max(1, _BLOCK // candidate.shape[-1])
        for block in (slice(begin, begin + size) for begin in range(0, len(tried), size)):
            changed = _changed(candidate, repairs, person[block], number[block], view[block])
            gain[block] = _value(sight, changed, lengths, parameters)[0] - value[person[block]]
        best = np.lexsort((-gain, person))
        best = best[np.append(True, np.diff(person[best]) > 0)]
        best = best[gain[best] > _LEAST_GAIN]
        if not len(best):
            return
        candidate[person[best]] = _changed(candidate, repairs, person[best], number[best], view[best])


def _repairs(skeleton: Skeleton) -> list[_Repair]:
    """Repairs of a view: arms or legs exchanged, and each arm and leg left out from the elbow or the knee on.

    Animals have none.
    """
    if not skeleton.is_persons:
        return []
    limbs = {
        (side, parts): skeleton.indices(tuple(f"{side}_{part}" for part in parts))
        for parts in (_ARM, _LEG)
        for side in ("left", "right")
    }
    exchanges = [
        _Repair(limbs["left", parts] + limbs["right", parts], limbs["right", parts] + limbs["left", parts])
        for parts in (_ARM, _LEG)
    ]
    return [*exchanges, *(_Repair(limb[1:], None) for limb in limbs.values())]


def _changed(
    candidate: Int[np.ndarray, "people joints cameras"],
    repairs: list[_Repair],
    person: Int[np.ndarray, " n"],
    number: Int[np.ndarray, " n"],
    view: Int[np.ndarray, " n"],
) -> Int[np.ndarray, "n joints cameras"]:
    changed = candidate[person]
    for k, repair in enumerate(repairs):
        rows = np.flatnonzero(number == k)
        where = rows[:, None], np.array(repair.to), view[rows, None]
        if repair.source is None:
            changed[where] = NOWHERE
        else:
            changed[where] = candidate[person[rows, None], np.array(repair.source), view[rows, None]]
    return changed


def _value(
    sight: _Sight,
    candidate: Int[np.ndarray, "poses joints cameras"],
    lengths: LimbLengths,
    parameters: ClusteringParameters,
) -> tuple[Float[np.ndarray, " poses"], np.ndarray]:
    """Value of poses, and which joints are in doubt, (poses, joints).

    Each candidate counts for or against the pose by its score, as in ``bodies.agree``. A limb whose length misses eq. 3
    counts against it, up to one at ``leniency`` times ``tau3``. So does a trunk whose shoulders and hips face
    opposite ways.
    """
    skeleton = sight.skeleton
    xyz_m = sight.locate(candidate)
    miss_m = sight.miss_m(xyz_m, candidate)
    agreement = sight.score[candidate] * np.nan_to_num(np.maximum(1.0 - (miss_m / DISPUTED_M) ** 2, -1.0))
    error = pose_length_error(xyz_m, skeleton, lengths)
    too_long = np.nan_to_num(np.minimum((error / (parameters.leniency * parameters.tau3)) ** 2, 1.0))
    is_twisted = np.zeros(len(xyz_m), bool)
    if skeleton.is_persons:
        shoulders, hips = (
            np.subtract(*(xyz_m[:, j, :2] for j in skeleton.indices((f"left_{part}", f"right_{part}"))))
            for part in ("shoulder", "hip")
        )
        is_twisted = (shoulders * hips).sum(-1) < 0
    # A neck between the shoulders is no observation of its own.
    observed = slice(1 if skeleton.sources[0] < 0 else 0, None)
    value = agreement[:, observed].sum((1, 2)) - too_long.sum(1) - is_twisted
    doubtful = (miss_m > DISPUTED_M).any(-1) | (error > parameters.tau3)
    of_limb = doubtful.copy()
    for joint, parent in enumerate(skeleton.parents[1:], 1):  # a wrong parent makes the length of its limb wrong, too
        of_limb[:, parent] |= error[:, joint] > parameters.tau3
    return value, of_limb | is_twisted[:, None]


def _renamed(candidates: Candidates, candidate: Int[np.ndarray, "people joints cameras"]) -> Candidates:
    """Name candidates by the joints that they are used for: left and right may be exchanged."""
    joint = candidates.joint.copy()
    used = np.nonzero(candidate >= 0)
    joint[candidate[used]] = used[1]
    return candidates._replace(joint=joint)


def _share(
    sight: _Sight, candidates: Candidates, candidate: Int[np.ndarray, "people joints cameras"], eps_m: float
) -> Float[np.ndarray, "people joints 3"]:
    """Give each joint the candidates that agree with it, whatever body they are part of, and locate it (eq. 4).

    Candidates that disagree with their person are free; a free candidate goes to the joint within ``eps_m`` of its ray.
    Changes ``candidate``: no candidate remains where a joint is not located.
    """
    xyz_m = sight.locate(candidate)
    for _ in range(2):
        _drop_strangers(sight, xyz_m, candidate)
        for joint in range(candidate.shape[1]):
            people = np.flatnonzero((candidate[:, joint] >= 0).sum(-1) >= 2)
            if len(people):
                candidate[people, joint] = _with_free(
                    sight, candidates, joint, xyz_m[people, joint], candidate[people, joint], eps_m
                )
        xyz_m = sight.locate(candidate)
    _drop_strangers(sight, xyz_m, candidate)
    located = np.nonzero((candidate >= 0).sum(-1) >= 2)
    chosen = candidate[located]
    exact_m = np.full(xyz_m.shape, np.nan)
    exact_m[located] = refine(sight.image_from_world, xyz_m[located], sight.points_px[chosen], sight.score[chosen])
    return sight.with_neck(exact_m)


def _drop_strangers(
    sight: _Sight, xyz_m: Float[np.ndarray, "people joints 3"], candidate: Int[np.ndarray, "people joints cameras"]
) -> None:
    """Remove candidates that show something else, and the last candidate of a joint; changes ``candidate``."""
    candidate[~(sight.miss_m(xyz_m, candidate) <= _FARTHEST_M)] = NOWHERE
    candidate[(candidate >= 0).sum(-1) < 2] = NOWHERE


def _with_free(
    sight: _Sight,
    candidates: Candidates,
    joint: int,
    xyz_m: Float[np.ndarray, "people 3"],
    chosen: Int[np.ndarray, "people cameras"],
    eps_m: float,
) -> Int[np.ndarray, "people cameras"]:
    """Add free candidates of one kind of joint to the people's joints of that kind; see ``clusters.adopt``."""
    of_kind = np.append(np.flatnonzero(candidates.joint == joint), NOWHERE)
    local = np.where(chosen >= 0, np.searchsorted(of_kind[:-1], chosen), NOWHERE)
    adopt(sight.image_from_world, candidates.where(of_kind[:-1]), xyz_m, local, eps_m)
    return of_kind[local]
