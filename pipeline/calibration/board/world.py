"""World of a calibrated rig: the board on the floor."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from pipeline.calibration.board.bundle import Placed
from pipeline.data import read_only
from pipeline.geometry.rigid import Rigid3

# A board lies still while it moves and turns less than this from one instant to the next, and for at least this time.
_STILL_M, _STILL_RAD, _STILL_S = 0.006, np.radians(0.6), 0.4
_CLEARANCE_M = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """World of a rig.

    Parameters
    ----------
    world_from_root
        Transform from the frame of the cameras: origin at the board's first corner, x along its rows, Z up.
    time_s
        Time at which the board lay there.
    is_certain
        Whether the board lay still with all cameras above it; else the best instant was taken.
    """

    world_from_root: Rigid3
    time_s: float
    is_certain: bool


def find_world(
    times_s: Float[np.ndarray, " instants"],
    placed: Sequence[Placed],
    centers_m: Float[np.ndarray, "cameras 3"],
    floor_time_s: float | None,
) -> World:
    """Find the floor: where the board lies at a given time, or during the longest time in which it lies still.

    Parameters
    ----------
    times_s, placed
        Instants and the board at each of them, ascending.
    centers_m
        Centres of the cameras, in their frame.
    floor_time_s
        Time at which the board lies on the floor; ``None``: the longest still stretch with all cameras above it.
    """
    if floor_time_s is not None:
        k = int(np.argmin(np.abs(times_s - floor_time_s)))
        return World(_world(placed[k].root_from_board), float(times_s[k]), is_certain=True)
    above = np.array([_above_m(one.root_from_board, centers_m).min() > _CLEARANCE_M for one in placed])
    stretches = [one for one in still_stretches(times_s, placed) if above[one.start : one.stop].all()]
    if stretches:
        longest = max(stretches, key=lambda one: times_s[one.stop - 1] - times_s[one.start])
        poses = [placed[k].root_from_board for k in longest]
        return World(_world(_mean(poses)), float(times_s[longest.start]), is_certain=True)
    # The highest share of cameras above the board, then the most cameras that see it.
    shares = [(_above_m(one.root_from_board, centers_m) > _CLEARANCE_M).mean() for one in placed]
    k = max(range(len(placed)), key=lambda k: (shares[k], len(placed[k].corners_px)))
    return World(_world(placed[k].root_from_board), float(times_s[k]), is_certain=False)


def still_stretches(times_s: Float[np.ndarray, " instants"], placed: Sequence[Placed]) -> list[range]:
    """Ranges of instants during which the board lies still."""
    stretches, begin = [], 0
    for k in range(1, len(placed) + 1):
        if k == len(placed) or not _is_still(placed[begin].root_from_board, placed[k].root_from_board):
            if times_s[k - 1] - times_s[begin] >= _STILL_S:
                stretches.append(range(begin, k))
            begin = k
    return stretches


def _is_still(one: Rigid3, other: Rigid3) -> bool:
    turn = Rotation.from_matrix(other.rotation @ one.rotation.T).magnitude()
    return bool(np.linalg.norm(one.translation_m - other.translation_m) < _STILL_M and turn < _STILL_RAD)


def _world(root_from_board: Rigid3) -> Rigid3:
    """World of a board that lies on the floor: its z points down, so y and z are turned."""
    return Rigid3(read_only(np.diag([1.0, -1.0, -1.0])), read_only(np.zeros(3))) @ root_from_board.inverse()


def _above_m(root_from_board: Rigid3, centers_m: Float[np.ndarray, "cameras 3"]) -> Float[np.ndarray, " cameras"]:
    """Heights of the cameras above the board's plane."""
    heights: np.ndarray = -root_from_board.inverse().apply(centers_m)[:, 2]
    return heights


def _mean(poses: Sequence[Rigid3]) -> Rigid3:
    rotation = Rotation.from_matrix(np.array([one.rotation for one in poses])).mean().as_matrix()
    return Rigid3(read_only(rotation), read_only(np.median([one.translation_m for one in poses], axis=0)))
