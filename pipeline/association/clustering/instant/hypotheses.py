"""3D hypotheses of joints: candidates of two views, triangulated (section 3.2.1)."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.association.clustering.instant.work_limits import MAX_HYPOTHESES, MAX_PAIRS, WorkLimits
from pipeline.geometry.triangulation import plane_rows, solve_normal

# Pairs that are triangulated at once; each row of their normal equations takes a megabyte.
_BLOCK = 2**15


class Candidates(NamedTuple):
    """2D candidates of all views at one instant."""

    joint: np.ndarray  # Number of the joint in the skeleton, (candidates,)
    view: np.ndarray  # Position of the camera, (candidates,)
    # Undistorted and distorted pixels, (candidates, 2)
    points_px: np.ndarray
    seen_px: np.ndarray
    score: np.ndarray  # The detector's confidence H(x), (candidates,)
    body: np.ndarray  # Detection of each candidate, (candidates,); -1 for a detector without bodies

    def where(self, chosen: Bool[np.ndarray, " candidates"] | Int[np.ndarray, " chosen"]) -> "Candidates":
        """Select candidates by a mask or by rows."""
        return Candidates(*(values[chosen] for values in self))


class Hypotheses(NamedTuple):
    """3D points triangulated from two candidates of different views."""

    xyz_m: np.ndarray  # World positions, (hypotheses, 3)
    pair: np.ndarray  # Rows of the two candidates, (hypotheses, 2)

    def where(self, chosen: Bool[np.ndarray, " hypotheses"] | Int[np.ndarray, " chosen"]) -> "Hypotheses":
        """Select hypotheses by a mask or by rows."""
        return Hypotheses(self.xyz_m[chosen], self.pair[chosen])


def reprojection_px(
    image_from_world: Float[np.ndarray, "*batch 3 4"],
    xyz_m: Float[np.ndarray, "*batch 3"],
    points_px: Float[np.ndarray, "*batch 2"],
) -> Float[np.ndarray, "*batch"]:
    """Reprojection error in undistorted pixels; infinite for points behind the camera and for NaN."""
    in_cam = (image_from_world[..., :3] @ xyz_m[..., None])[..., 0] + image_from_world[..., 3]
    in_front = in_cam[..., 2] > 0
    projected_px = in_cam[..., :2] / np.where(in_front, in_cam[..., 2], 1.0)[..., None]
    return np.where(in_front, np.linalg.norm(projected_px - points_px, axis=-1), np.inf)


def meet(
    image_from_world: Float[np.ndarray, "cameras 3 4"], candidates: Candidates, tau1_px: float, limits: WorkLimits
) -> Hypotheses:
    """Triangulate all pairs of a joint's candidates in two views; keep those with a reprojection error up to ``tau1``.

    For a joint with more than ``MAX_PAIRS`` pairs, some pairs of views are left out; see ``views_that_meet``. Of more
    than ``MAX_HYPOTHESES`` hypotheses, those with the smallest errors are kept.
    """
    views = image_from_world[candidates.view]
    rows = plane_rows(views, candidates.points_px[:, None])[:, 0]
    normal = rows.swapaxes(-1, -2) @ rows
    of_joints = [Hypotheses(np.empty((0, 3)), np.empty((0, 2), int))]
    for joint in np.unique(candidates.joint):
        pairs = _pairs(image_from_world, candidates, np.flatnonzero(candidates.joint == joint), limits)
        met, errors_px = [], [np.empty(0)]
        for pair in np.split(pairs, range(_BLOCK, len(pairs), _BLOCK)):
            xyz_m = solve_normal(normal[pair[:, 0]] + normal[pair[:, 1]])
            error_px = reprojection_px(
                views[pair], np.broadcast_to(xyz_m[:, None], (*pair.shape, 3)), candidates.points_px[pair]
            ).max(-1)
            near = error_px <= tau1_px
            met.append(Hypotheses(xyz_m, pair).where(near))
            errors_px.append(error_px[near])
        together = _joined(met)
        if not limits.allows(len(together.pair), MAX_HYPOTHESES):
            best = np.argsort(np.concatenate(errors_px), kind="stable")[:MAX_HYPOTHESES]
            together = together.where(np.sort(best))
        of_joints.append(together)
    return _joined(of_joints)


def _joined(hypotheses: Sequence[Hypotheses]) -> Hypotheses:
    return Hypotheses(*(np.concatenate(values) for values in zip(*hypotheses, strict=True)))


def _pairs(
    image_from_world: Float[np.ndarray, "cameras 3 4"],
    candidates: Candidates,
    of_joint: Int[np.ndarray, " _"],
    limits: WorkLimits,
) -> Int[np.ndarray, "pairs 2"]:
    """Rows of all pairs of a joint's candidates in two views, in order of the views."""
    view = candidates.view[of_joint]
    count = np.bincount(view, minlength=len(image_from_world))
    num_pairs = np.triu(np.outer(count, count), 1)
    wanted = view[:, None] < view
    if not limits.allows(int(num_pairs.sum()), MAX_PAIRS):
        wanted &= views_that_meet(image_from_world, num_pairs)[view[:, None], view]
    return of_joint[np.argwhere(wanted)]


def views_that_meet(
    image_from_world: Float[np.ndarray, "cameras 3 4"], num_pairs: Int[np.ndarray, "cameras cameras"]
) -> Bool[np.ndarray, "cameras cameras"]:
    """Choose pairs of views with at most ``MAX_PAIRS`` pairs of candidates together, each view's best partners first.

    The best partner views at a right angle: triangulation with it is most accurate.
    """
    axes = image_from_world[:, 2, :3] / np.linalg.norm(image_from_world[:, 2, :3], axis=-1, keepdims=True)
    along = np.abs(axes @ axes.T)
    np.fill_diagonal(along, np.inf)
    rank = along.argsort(axis=1, kind="stable").argsort(axis=1, kind="stable")
    first, second = np.nonzero(num_pairs)
    in_order = np.argsort(np.minimum(rank, rank.T)[first, second], kind="stable")
    kept = in_order[np.cumsum(num_pairs[first, second][in_order]) <= MAX_PAIRS]
    meeting = np.zeros(num_pairs.shape, bool)
    meeting[first[kept], second[kept]] = True
    return meeting
