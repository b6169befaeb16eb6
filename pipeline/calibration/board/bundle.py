"""Bundle adjustment of cameras and of the board at every chosen instant."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from jaxtyping import Float, Int

from pipeline.calibration.adjustment.adjust import Adjustment, adjust, block_covariance
from pipeline.calibration.adjustment.parameters import (
    DISTORTION,
    EXTRINSICS,
    FOCAL,
    PRINCIPAL,
    Free,
    no_prior,
    none_free,
)
from pipeline.calibration.adjustment.problem import AdjustmentProblem, Loss, PointObservations
from pipeline.calibration.adjustment.structure import RigidBodies
from pipeline.calibration.board.spec import Board
from pipeline.data.arrays import read_only
from pipeline.data.cameras import Camera
from pipeline.data.rigid import Rigid3
from pipeline.geometry.camera import project

# A board whose best pose leaves a larger median error than this share of the picture's diagonal was mistaken.
_MAX_ERROR_SHARE = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class PlacedBoard:
    """Board at an instant."""

    root_from_board: Rigid3  # Pose in the frame of the cameras
    # Corners by number of the camera, numbered alike in all of them
    corners_px: Mapping[int, Float[np.ndarray, "corners 2"]]
    error_px: float  # Mean over the cameras of the median distance of the corners from their projections


def place_board(
    cameras: Mapping[int, Camera],
    corners_px: Mapping[int, Float[np.ndarray, "corners 2"]],
    poses: Mapping[int, Sequence[Rigid3]],
    board: Board,
) -> PlacedBoard | None:
    """Find the pose and the numberings that explain an instant's views best; ``None`` if none explains them.

    Cameras with known poses are by number, corners and possible poses of the board by the camera that sees it.
    """
    best: PlacedBoard | None = None
    for number, possible in poses.items():
        root_from_cam = cameras[number].cam_from_world.inverse()
        for pose in possible:
            root_from_board = root_from_cam @ pose
            placed = _numbered(cameras, corners_px, root_from_board, board)
            if best is None or placed.error_px < best.error_px:
                best = placed
    if best is None:
        return None
    diagonal_px = max(np.hypot(*cameras[number].size_px) for number in corners_px)
    return best if best.error_px <= _MAX_ERROR_SHARE * diagonal_px else None


def _numbered(
    cameras: Mapping[int, Camera],
    corners_px: Mapping[int, Float[np.ndarray, "corners 2"]],
    root_from_board: Rigid3,
    board: Board,
) -> PlacedBoard:
    """Number the corners of each view so that they fit a pose of the board."""
    xyz_m = root_from_board.apply(board.corners_m)
    chosen, errors_px = {}, []
    for number, seen_px in corners_px.items():
        projected = project(cameras[number], xyz_m)
        numberings = (seen_px, seen_px[::-1]) if board.is_ambiguous else (seen_px,)
        medians_px = [_median_px(numbered, projected) for numbered in numberings]
        chosen[number] = numberings[int(np.argmin(medians_px))]
        errors_px.append(min(medians_px))
    return PlacedBoard(root_from_board, chosen, float(np.mean(errors_px)))


def _median_px(seen_px: np.ndarray, projected_px: np.ndarray) -> float:
    """Median distance of the corners that are seen; infinite if one is behind the camera."""
    distance = np.linalg.norm(projected_px - seen_px, axis=-1)[np.isfinite(seen_px).all(-1)]
    return float(np.median(np.nan_to_num(distance, nan=np.inf)))


def refine_boards(cameras: Sequence[Camera], placed: Sequence[PlacedBoard], board: Board) -> list[PlacedBoard]:
    """Fit the poses of the board to the views of all cameras, which stay."""
    fitted = _fit(cameras, none_free(len(cameras)), [[instant] for instant in placed], board)
    return [
        replace(instant, root_from_board=pose) for instant, pose in zip(placed, fitted.root_from_boards, strict=True)
    ]


def alike_numbered(placed: Sequence[PlacedBoard], board: Board) -> list[PlacedBoard]:
    """Number an ambiguous board at each instant as at the instant before, as far as it turned less than a quarter."""
    if not board.is_ambiguous:
        return list(placed)
    half_turn = Rigid3(read_only(np.diag([-1.0, -1.0, 1.0])), read_only(board.corners_m[-1]))
    alike = list(placed[:1])
    for current in placed[1:]:
        # The trace of a rotation by more than a quarter about the board's normal is below 1.
        trace = np.trace(alike[-1].root_from_board.rotation.T @ current.root_from_board.rotation)
        turned = current.root_from_board @ half_turn
        if np.trace(alike[-1].root_from_board.rotation.T @ turned.rotation) > trace:
            corners_px = {number: seen_px[::-1] for number, seen_px in current.corners_px.items()}
            alike.append(replace(current, root_from_board=turned, corners_px=corners_px))
        else:
            alike.append(current)
    return alike


@dataclass(frozen=True, slots=True, eq=False)
class BoardFit:
    """Cameras and boards that were adjusted together."""

    problem: AdjustmentProblem
    adjustment: Adjustment

    @property
    def owner(self) -> Int[np.ndarray, " observations"]:
        """Number of the camera of each residual."""
        return self.problem.observations.camera

    @property
    def root_from_boards(self) -> list[Rigid3]:
        """Pose of each board."""
        bodies = cast("RigidBodies", self.adjustment.structure)
        return [
            Rigid3(read_only(turn), read_only(m)) for turn, m in zip(bodies.rotation, bodies.translation_m, strict=True)
        ]

    def last_covariance(self, number: int) -> Float[np.ndarray, "unknowns unknowns"]:
        """Covariance of the poses of the last boards: steps of ``adjustment.structure.RigidBodies``, six a board."""
        num_blocks = self.adjustment.structure.num_blocks
        return block_covariance(self.problem, self.adjustment, np.arange(num_blocks - number, num_blocks))


def adjust_board_rig(
    cameras: Sequence[Camera],
    root: int,
    boards: Sequence[Sequence[PlacedBoard]],
    board: Board,
    coefficients: Sequence[Sequence[int]] | None,
) -> BoardFit:
    """Adjust cameras and boards together.

    Parameters
    ----------
    root
        Number of the camera that stays.
    boards
        Instants at which the board has the same pose: usually one, and many where it lies still.
    coefficients
        Numbers of each camera's distortion coefficients that may change; ``None``: the intrinsics are given, and stay.
    """
    free = none_free(len(cameras))
    free[:, EXTRINSICS] = True
    free[root, EXTRINSICS] = False
    if coefficients is not None:
        free[:, FOCAL] = free[:, PRINCIPAL] = True
        for number, chosen in enumerate(coefficients):
            free[number, [DISTORTION.start + k for k in chosen]] = True
    return _fit(cameras, free, boards, board)


def _fit(cameras: Sequence[Camera], free: Free, boards: Sequence[Sequence[PlacedBoard]], board: Board) -> BoardFit:
    bodies = RigidBodies(
        read_only(np.array([instants[0].root_from_board.rotation for instants in boards])),
        read_only(np.array([instants[0].root_from_board.translation_m for instants in boards])),
    )
    observations = _observations(boards, board)
    problem = AdjustmentProblem(tuple(cameras), free, no_prior(len(cameras)), observations, Loss.CAUCHY)
    return BoardFit(problem, adjust(problem, bodies))


def _observations(boards: Sequence[Sequence[PlacedBoard]], board: Board) -> PointObservations:
    camera: list[Int[np.ndarray, " n"]] = []
    block, model_m, points_px = [], [], []
    views = [
        (number, *view)
        for number, instants in enumerate(boards)
        for instant in instants
        for view in instant.corners_px.items()
    ]
    for number, of_camera, corners_px in views:
        seen = np.isfinite(corners_px).all(-1)
        camera.append(np.full(seen.sum(), of_camera))
        block.append(np.full(seen.sum(), number))
        model_m.append(board.corners_m[seen])
        points_px.append(corners_px[seen])
    return PointObservations(
        np.concatenate(camera), np.concatenate(block), np.concatenate(model_m), np.concatenate(points_px)
    )
