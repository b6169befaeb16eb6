"""Where two views' candidates meet: all hypotheses of where a joint may be (section 3.2.1)."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.geometry.triangulation import plane_rows, solve_normal


class Candidates(NamedTuple):
    """2D candidates at one instant, of all views.

    Parameters
    ----------
    joint
        Which joint of the skeleton, (candidates,).
    view
        Position of the camera, (candidates,).
    points_px, seen_px
        Undistorted pixels, and pixels as seen, (candidates, 2).
    score
        The detector's confidence H(x), (candidates,).
    body
        The detection that each belongs to, (candidates,), -1 where a detector has no bodies.
    """

    joint: np.ndarray
    view: np.ndarray
    points_px: np.ndarray
    seen_px: np.ndarray
    score: np.ndarray
    body: np.ndarray

    def where(self, chosen: Bool[np.ndarray, " candidates"] | Int[np.ndarray, " chosen"]) -> "Candidates":
        """Some of them."""
        return Candidates(*(values[chosen] for values in self))


class Hypotheses(NamedTuple):
    """Points where the rays of two candidates meet.

    Parameters
    ----------
    xyz_m
        (hypotheses, 3).
    pair
        The two candidates, (hypotheses, 2), of two views.
    """

    xyz_m: np.ndarray
    pair: np.ndarray

    def where(self, chosen: Bool[np.ndarray, " hypotheses"]) -> "Hypotheses":
        """Some of them."""
        return Hypotheses(self.xyz_m[chosen], self.pair[chosen])


def reprojection_px(
    image_from_world: Float[np.ndarray, "*batch 3 4"],
    xyz_m: Float[np.ndarray, "*batch 3"],
    points_px: Float[np.ndarray, "*batch 2"],
) -> Float[np.ndarray, "*batch"]:
    """Reprojection error in undistorted pixels; infinite behind the camera and for NaN."""
    in_cam = (image_from_world[..., :3] @ xyz_m[..., None])[..., 0] + image_from_world[..., 3]
    in_front = in_cam[..., 2] > 0
    projected_px = in_cam[..., :2] / np.where(in_front, in_cam[..., 2], 1.0)[..., None]
    return np.where(in_front, np.linalg.norm(projected_px - points_px, axis=-1), np.inf)


def meet(image_from_world: Float[np.ndarray, "cameras 3 4"], candidates: Candidates, tau1_px: float) -> Hypotheses:
    """Triangulate all pairs of a joint's candidates in two views; keep those with a small reprojection error."""
    views = image_from_world[candidates.view]
    pair = _pairs(candidates)
    rows = plane_rows(views, candidates.points_px[:, None])[:, 0]
    normal = rows.swapaxes(-1, -2) @ rows
    xyz_m = solve_normal(normal[pair[:, 0]] + normal[pair[:, 1]])
    errors_px = reprojection_px(
        views[pair], np.broadcast_to(xyz_m[:, None], (*pair.shape, 3)), candidates.points_px[pair]
    )
    return Hypotheses(xyz_m, pair).where(np.all(errors_px <= tau1_px, axis=-1))


def _pairs(candidates: Candidates) -> Int[np.ndarray, "pairs 2"]:
    """Any two candidates of a joint in two views, the first in the view that comes first."""
    found = [np.empty((0, 2), int)]
    for joint in np.unique(candidates.joint):
        mine = np.flatnonzero(candidates.joint == joint)
        found.append(mine[np.argwhere(candidates.view[mine][:, None] < candidates.view[mine])])
    return np.concatenate(found)
