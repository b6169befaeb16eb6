"""Instants at which several cameras see the board, and the relative poses of the cameras."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from pipeline.calibration.board.views import BoardViews
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera
from pipeline.core.data.rigid import Rigid3

# Relative poses of two instants agree within these limits: an angle, and a share of the distance to the board.
_AGREE_RAD, _AGREE_SHARE = np.radians(4.0), 0.06
# Instants whose combinations are tried as the relative pose of a pair.
_NUM_TRIED = 60


@dataclass(frozen=True, slots=True, eq=False)
class BoardRig:
    """Views of all cameras, their cameras, and the instants that they share."""

    views: tuple[BoardViews, ...]
    cameras: tuple[Camera, ...]
    poses: tuple[tuple[Sequence[Rigid3], ...], ...]  # Possible poses of the board at each view of each camera
    instants: np.ndarray  # Number of the view of each camera at each instant, -1 where it has none

    def shared(self, first: int, second: int) -> list[tuple[Sequence[Rigid3], Sequence[Rigid3]]]:
        """Possible poses in two cameras at the instants at which both see the board."""
        both = self.instants[(self.instants[:, [first, second]] >= 0).all(1)]
        return [(self.poses[first][row[first]], self.poses[second][row[second]]) for row in both]


@dataclass(frozen=True, slots=True, eq=False)
class BoardPair:
    """Relative pose of two cameras."""

    # Numbers of the cameras
    first: int
    second: int
    second_from_first: Rigid3  # Transform between the cameras
    # Number of instants that agree with it, and of all instants at which both see the board
    num_agreeing: int
    num_shared: int


def relate_by_board(
    first: int, second: int, poses: Sequence[tuple[Sequence[Rigid3], Sequence[Rigid3]]]
) -> BoardPair | None:
    """Find the relative pose of two cameras that most instants agree with; ``None`` if they share no view.

    ``poses`` are the possible ones in both cameras at each shared instant. Wrong solutions of the plane, and wrong
    numberings, differ from instant to instant; the right ones give the same relative pose at all of them.
    """
    if not poses:
        return None
    tried = np.unique(np.linspace(0, len(poses) - 1, min(len(poses), _NUM_TRIED)).round().astype(int))
    rotations, shifts_m, owner, depth_m = _stacked(poses)
    best: tuple[float, Rigid3, int] | None = None
    for number in np.flatnonzero(np.isin(owner, tried)):
        candidate = Rigid3(rotations[number], shifts_m[number])
        agreeing, cost = _agreement(candidate, rotations, shifts_m, owner, depth_m, len(poses))
        if best is None or cost < best[0]:
            best = cost, _mean(candidate, rotations, shifts_m, agreeing), int(np.count_nonzero(agreeing >= 0))
    if best is None:
        return None
    return BoardPair(first, second, best[1], best[2], len(poses))


def _stacked(
    poses: Sequence[tuple[Sequence[Rigid3], Sequence[Rigid3]]],
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Rotations, shifts, instants and distances to the board of all combinations of poses in both cameras.

    Equal half turns in both cameras give equal relative poses.
    """
    relatives = [
        (second @ first.inverse(), number, second.translation_m)
        for number, (in_first, in_second) in enumerate(poses)
        for first in in_first
        for second in in_second
    ]
    rotations = np.array([relative.rotation for relative, _, _ in relatives])
    shifts_m = np.array([relative.translation_m for relative, _, _ in relatives])
    owner = np.array([number for _, number, _ in relatives])
    depth_m = np.array([np.linalg.norm(place_m) for _, _, place_m in relatives])
    return rotations, shifts_m, owner, depth_m


def _agreement(
    candidate: Rigid3,
    rotations: Float[np.ndarray, "n 3 3"],
    shifts_m: Float[np.ndarray, "n 3"],
    owner: Int[np.ndarray, " n"],
    depth_m: Float[np.ndarray, " n"],
    num_instants: int,
) -> tuple[Int[np.ndarray, " instants"], float]:
    """Number of the best combination of each instant, -1 where none agrees, and the truncated cost of all instants."""
    cosine = (np.einsum("nij,ij->n", rotations, candidate.rotation) - 1) / 2
    angle = np.arccos(np.clip(cosine, -1.0, 1.0))
    share = np.linalg.norm(shifts_m - candidate.translation_m, axis=-1) / depth_m
    cost = np.minimum(1.0, (angle / _AGREE_RAD) ** 2 + (share / _AGREE_SHARE) ** 2)
    agreeing, lowest = np.full(num_instants, -1), np.ones(num_instants)
    order = np.argsort(-cost)
    lowest[owner[order]] = cost[order]  # the last one written is the lowest
    agreeing[owner[order]] = order
    agreeing[lowest >= 1.0] = -1
    return agreeing, float(lowest.sum())


def _mean(candidate: Rigid3, rotations: np.ndarray, shifts_m: np.ndarray, agreeing: np.ndarray) -> Rigid3:
    """Mean rotation and median shift of the combinations that agree."""
    chosen = agreeing[agreeing >= 0]
    if not len(chosen):
        return candidate
    rotation = Rotation.from_matrix(rotations[chosen]).mean().as_matrix()
    return Rigid3(read_only(rotation), read_only(np.median(shifts_m[chosen], axis=0)))


def spanning_tree(num_cameras: int, pairs: Sequence[BoardPair]) -> Mapping[int, Rigid3]:
    """Poses of the cameras that are linked to the best linked one, as transforms from this one.

    Pairs with more agreeing instants come first (Prim's maximum spanning tree).
    """
    agreeing = np.zeros(num_cameras)
    for pair in pairs:
        agreeing[[pair.first, pair.second]] += pair.num_agreeing
    poses = {int(np.argmax(agreeing)): Rigid3(read_only(np.eye(3)), read_only(np.zeros(3)))}
    while True:
        edges = [pair for pair in pairs if (pair.first in poses) != (pair.second in poses)]
        if not edges:
            return poses
        edge = max(edges, key=lambda pair: pair.num_agreeing)
        if edge.first in poses:
            poses[edge.second] = edge.second_from_first @ poses[edge.first]
        else:
            poses[edge.first] = edge.second_from_first.inverse() @ poses[edge.second]


def match_times(times_s: Sequence[Float[np.ndarray, " _"]], tolerance_s: float) -> Int[np.ndarray, "instants cameras"]:
    """Number of the view of each camera at each instant, ascending in time; -1 where a camera has no view.

    Views within the tolerance of the first one of an instant belong to it, at most one a camera.
    """
    camera = np.concatenate([np.full(len(camera_s), k) for k, camera_s in enumerate(times_s)])
    view = np.concatenate([np.arange(len(camera_s)) for camera_s in times_s])
    time_s = np.concatenate([np.asarray(camera_s, float) for camera_s in times_s])
    order = np.lexsort((camera, time_s))
    instants: list[list[int]] = []
    begin_s = -np.inf
    for k in order:
        if not np.isfinite(time_s[k]):
            continue
        if time_s[k] - begin_s > tolerance_s or instants[-1][camera[k]] >= 0:
            instants.append([-1] * len(times_s))
            begin_s = time_s[k]
        instants[-1][camera[k]] = int(view[k])
    return np.array(instants, int).reshape(-1, len(times_s))
