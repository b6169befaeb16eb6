"""World of a calibrated rig: the board on the floor."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from pipeline.calibration.board.board_adjustment import PlacedBoard
from pipeline.calibration.board.poses import BoardMotion
from pipeline.core.data.arrays import read_only
from pipeline.core.data.rigid import Rigid3

# A board lies still while it moves and turns less than this from one instant to the next, and for at least this time.
_STILL_M, _STILL_RAD, _STILL_S = 0.006, np.radians(0.6), 0.4
_CLEARANCE_M = 0.05
# Places are in one plane within these limits: a rig leaves something open, and floors are not quite flat.
_PLANE_RAD, _PLANE_M = np.radians(1.5), 0.015
# Standard deviations of a board from the plane of the floor: boards are bent, floors are uneven.
_UNEVEN_RAD, _UNEVEN_M = 1e-3, 1e-3
# Instants of a place that are used.
_MOST_INSTANTS = 25


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """Places on the floor at which the board lies."""

    stretches: tuple[range, ...]  # Instants at each place; the first place is the origin of the world
    is_certain: bool  # True if the board lies still there with all cameras above it; else the best instant was taken


@dataclass(frozen=True, slots=True, eq=False)
class BoardWorld:
    """World of a rig."""

    # Transform from the frame of the cameras: origin at the board's first corner, x along its rows, Z up
    world_from_root: Rigid3
    tilt_sigma_rad: float  # Standard deviation of the floor's tilt: of the less certain of its two directions


def find_places(motion: BoardMotion, centers_m: Float[np.ndarray, "cameras 3"], floor_time_s: float | None) -> Places:
    """Find where the board lies on the floor: all places in one plane.

    ``centers_m``: centres of the cameras, in their frame. ``floor_time_s``: time at which the board lies on the floor;
    ``None``: the plane in which it lies still for the longest time, with all cameras above.
    """
    times_s, placed, middle_m = motion.time_s, motion.boards, motion.middle_m
    above = np.array([_above_m(board.root_from_board, centers_m).min() > _CLEARANCE_M for board in placed])
    stretches = still_stretches(times_s, placed)
    if floor_time_s is not None:
        k = int(np.argmin(np.abs(times_s - floor_time_s)))
        first = next((stretch for stretch in stretches if k in stretch), range(k, k + 1))
        return Places(_in_plane(first, stretches, placed, middle_m), is_certain=True)
    still = [stretch for stretch in stretches if above[stretch.start : stretch.stop].all()]
    planes = [_in_plane(stretch, stretches, placed, middle_m) for stretch in still]
    if planes:
        # Of the places in a plane, the longest one is the origin.
        longest = max(planes, key=lambda plane: (_total_s(times_s, plane), _total_s(times_s, plane[:1])))
        return Places(longest, is_certain=True)
    # The highest share of cameras above the board, then the most cameras that see it.
    shares = [(_above_m(board.root_from_board, centers_m) > _CLEARANCE_M).mean() for board in placed]
    k = max(range(len(placed)), key=lambda k: (shares[k], len(placed[k].corners_px)))
    return Places((range(k, k + 1),), is_certain=False)


def _total_s(times_s: Float[np.ndarray, " instants"], stretches: Sequence[range]) -> float:
    return float(sum(times_s[stretch.stop - 1] - times_s[stretch.start] for stretch in stretches))


def _in_plane(
    first: range, stretches: Sequence[range], placed: Sequence[PlacedBoard], middle_m: Float[np.ndarray, " 3"]
) -> tuple[range, ...]:
    plane = placed[first.start].root_from_board
    coplanar = [first]
    for stretch in stretches:
        board = plane.inverse() @ placed[stretch.start].root_from_board
        is_level = board.rotation[2, 2] > np.cos(_PLANE_RAD)
        if stretch != first and is_level and abs(board.apply(middle_m)[2]) < _PLANE_M:
            coplanar.append(stretch)
    return tuple(coplanar)


def chosen_instants(stretch: range) -> list[int]:
    """Instants of a place that are used, spread evenly."""
    return [
        stretch[k]
        for k in np.unique(np.linspace(0, len(stretch) - 1, min(len(stretch), _MOST_INSTANTS)).round().astype(int))
    ]


def find_board_world(
    root_from_boards: Sequence[Rigid3],
    covariance: Float[np.ndarray, "unknowns unknowns"],
    middle_m: Float[np.ndarray, " 3"],
) -> BoardWorld:
    """Fit the floor's plane to the board at each of its places (generalised least squares).

    Directions of the boards' normals and heights of their middles, relative to the first board, are the observations:
    linear in the slopes and the height of the plane, which are small. The boards are in the frame of the cameras; their
    covariance is of steps of ``adjustment.structure.RigidBodies`` whose origins are the boards' middles, six a board.
    """
    first = root_from_boards[0]
    middle_in_root_m = first.apply(middle_m)
    seen, by_plane, by_pose = [], [], np.zeros((3 * len(root_from_boards), len(covariance)))
    for k, board in enumerate(root_from_boards):
        normal = first.rotation.T @ board.rotation[:, 2]
        x_m, y_m, z_m = first.rotation.T @ (board.apply(middle_m) - middle_in_root_m)
        seen += [-normal[0], -normal[1], z_m]
        by_plane += [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [x_m, y_m, 1.0]]
        # A small rotation w moves a vector v by w x v = -[v]_x w.
        rows = slice(3 * k, 3 * k + 2), slice(6 * k, 6 * k + 3)
        by_pose[rows] = (first.rotation.T @ _cross(board.rotation[:, 2]))[:2]
        by_pose[3 * k + 2, 6 * k + 3 : 6 * k + 6] = first.rotation[:, 2]
    uneven = np.diag(np.tile(np.array([_UNEVEN_RAD, _UNEVEN_RAD, _UNEVEN_M]) ** 2, len(root_from_boards)))
    weighted = np.linalg.solve(by_pose @ covariance @ by_pose.T + uneven, np.array(by_plane))
    of_plane = np.linalg.inv(np.array(by_plane).T @ weighted)
    slope_x, slope_y, height_m = of_plane @ weighted.T @ np.array(seen)
    normal = first.rotation @ np.array([-slope_x, -slope_y, 1.0])
    normal /= np.linalg.norm(normal)
    on_plane_m = middle_in_root_m + height_m * first.rotation[:, 2]
    corner_m = first.translation_m - normal * (normal @ (first.translation_m - on_plane_m))
    along = first.rotation[:, 0] - normal * (normal @ first.rotation[:, 0])
    along /= np.linalg.norm(along)
    rotation = np.column_stack([along, np.cross(normal, along), normal])
    # A board that lies on the floor has its z down, so y and z are turned.
    turned = Rigid3(read_only(np.diag([1.0, -1.0, -1.0])), read_only(np.zeros(3)))
    world_from_root = turned @ Rigid3(read_only(rotation), read_only(corner_m)).inverse()
    return BoardWorld(world_from_root, float(np.sqrt(np.linalg.eigvalsh(of_plane[:2, :2]).max())))


def _cross(vector: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "3 3"]:
    """Matrix [v]_x of the product v x w."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def still_stretches(times_s: Float[np.ndarray, " instants"], placed: Sequence[PlacedBoard]) -> list[range]:
    """Ranges of instants during which the board lies still."""
    stretches, begin = [], 0
    for k in range(1, len(placed) + 1):
        if k == len(placed) or not _is_still(placed[begin].root_from_board, placed[k].root_from_board):
            if times_s[k - 1] - times_s[begin] >= _STILL_S:
                stretches.append(range(begin, k))
            begin = k
    return stretches


def _is_still(first: Rigid3, second: Rigid3) -> bool:
    turn = Rotation.from_matrix(second.rotation @ first.rotation.T).magnitude()
    return bool(np.linalg.norm(first.translation_m - second.translation_m) < _STILL_M and turn < _STILL_RAD)


def _above_m(root_from_board: Rigid3, centers_m: Float[np.ndarray, "cameras 3"]) -> Float[np.ndarray, " cameras"]:
    heights: np.ndarray = -root_from_board.inverse().apply(centers_m)[:, 2]
    return heights
