"""Link of poses to tracks by bipartite matching from instant to instant (section 3.5), and distance of two poses."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from scipy.optimize import linear_sum_assignment

from pipeline.association.clustering.clustering_parameters import ClusteringParameters
from pipeline.core.progress import OnShare, ignore


def mean_distance_m(
    first_m: Float[np.ndarray, "*#batch joints 3"], second_m: Float[np.ndarray, "*#batch joints 3"]
) -> Float[np.ndarray, "*batch"]:
    """Mean distance in metres of the joints that both poses have; infinite if they share none.

    Positions are in the world, NaN where a joint is unknown.
    """
    apart_m = np.linalg.norm(first_m - second_m, axis=-1)
    shared = np.isfinite(apart_m)
    total_m = np.where(shared, apart_m, 0.0).sum(-1)
    return np.where(shared.any(-1), total_m / np.maximum(shared.sum(-1), 1), np.inf)


# Noise of a pose, added to the distance that a body may move.
_NOISE_M = 0.15
_FAR_M = 1e6


@dataclass(slots=True)
class Track:
    """Poses of one person."""

    # Instant, and position among the instant's poses, of each pose
    members: list[tuple[int, int]] = field(default_factory=list)
    # Last position of each torso joint, NaN where it was never found
    last_m: np.ndarray = field(default_factory=lambda: np.empty(0))
    last_s: float = -np.inf  # Time of the last pose


def link(
    torsos_m: Sequence[Float[np.ndarray, "_ torso 3"]],
    instants_s: Float[np.ndarray, " instants"],
    parameters: ClusteringParameters,
    on_share: OnShare = ignore,
) -> list[Track]:
    """Link poses by the mean distance of their torso joints, in order of time; unmatched poses start tracks.

    Torso joints of all poses at each instant are NaN where they were not found; times ascend.
    """
    tracks: list[Track] = []
    alive: list[Track] = []
    for instant, (torso_m, time_s) in enumerate(zip(torsos_m, instants_s.tolist(), strict=True)):
        alive = [track for track in alive if time_s - track.last_s <= parameters.max_unseen_s + 1e-9]
        partner = _match(alive, torso_m, time_s, parameters)
        for number, pose_m in enumerate(torso_m):
            track = partner.get(number)
            if track is None:
                track = Track(last_m=pose_m)
                tracks.append(track)
                alive.append(track)
            track.members.append((instant, number))
            track.last_m = np.where(np.isnan(pose_m), track.last_m, pose_m)
            track.last_s = time_s
        on_share((instant + 1) / len(torsos_m))
    return tracks


def _match(
    alive: Sequence[Track],
    torso_m: Float[np.ndarray, "people torso 3"],
    time_s: float,
    parameters: ClusteringParameters,
) -> dict[int, Track]:
    """Track of each matched pose, by position of the pose."""
    if not alive or not len(torso_m):
        return {}
    mean_m = mean_distance_m(np.array([track.last_m for track in alive])[:, None], torso_m[None])
    reach_m = _NOISE_M + parameters.speed_m_s * np.array([[time_s - track.last_s] for track in alive])
    allowed = mean_m <= reach_m
    rows, columns = linear_sum_assignment(np.where(allowed, mean_m, _FAR_M))
    return {int(j): alive[int(i)] for i, j in zip(rows, columns, strict=True) if allowed[i, j]}
