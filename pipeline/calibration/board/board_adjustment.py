"""Bundle adjustment of cameras and of the board at every chosen instant."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import cast

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.calibration.adjustment import parameters
from pipeline.calibration.adjustment.bundle import Adjustment, adjust, block_covariance
from pipeline.calibration.adjustment.deviations import Deviations, first_deviations
from pipeline.calibration.adjustment.problem import AdjustmentProblem, Loss, PointObservations, RigidBodies
from pipeline.calibration.board.spec import Board
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera
from pipeline.core.data.rigid import Rigid3
from pipeline.geometry.camera import project

# Standard deviations of OpenCV's first five coefficients where a lens has none by its model: a simple model fits the
# views well, and still moves the focal length and the principal point by more than their noise.
_PLAUSIBLE = np.array([0.3, 0.3, 0.002, 0.002, 0.3])
# Least number of boards with known speeds that tell whether differences grow with it.
_MIN_KNOWN_SPEEDS = 12
# A board whose best pose leaves a larger median error than this share of the picture's diagonal was mistaken.
_MAX_ERROR_SHARE = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class PlacedBoard:
    """Board at an instant."""

    root_from_board: Rigid3  # Pose in the frame of the cameras
    # Corners by number of the camera, numbered alike in all of them
    corners_px: Mapping[int, Float[np.ndarray, "corners 2"]]
    error_px: float  # Mean over the cameras of the median distance of the corners from their projections
    time_s: Mapping[int, float] = field(default_factory=dict)  # Time of each view, by number of the camera

    @property
    def mean_time_s(self) -> float:
        """Mean time of the views; NaN if they have no times."""
        return float(np.mean(list(self.time_s.values()))) if self.time_s else float("nan")


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
    free, prior = parameters.none_free(len(cameras)), parameters.no_prior(len(cameras))
    fitted = _fit(cameras, free, prior, [[instant] for instant in placed], board)
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
    middle_m: Float[np.ndarray, " 3"]  # Middle of the board, in its frame: origin of its body

    @property
    def owner(self) -> Int[np.ndarray, " observations"]:
        """Number of the camera of each residual."""
        return self.problem.observations.camera

    @property
    def root_from_boards(self) -> list[Rigid3]:
        """Pose of each board."""
        bodies = cast("RigidBodies", self.adjustment.structure)
        return [
            Rigid3(read_only(turn), read_only(place_m - turn @ self.middle_m))
            for turn, place_m in zip(bodies.rotation, bodies.translation_m, strict=True)
        ]

    @property
    def _is_shared(self) -> Bool[np.ndarray, "cameras boards"]:
        """Boards that a camera sees together with another one."""
        is_seen = np.zeros((len(self.problem.cameras), self.adjustment.structure.num_blocks), bool)
        is_seen[self.problem.observations.camera, self.problem.observations.block] = True
        return is_seen & (is_seen.sum(0) > 1)

    def apart_m(self, number: int) -> float:
        """Root mean square distance between the board as a camera sees it and the pose that all cameras share."""
        shift_m = self._deviations.total[number, self._is_shared[number], 3:]
        return float(np.sqrt((shift_m**2).sum(-1).mean())) if len(shift_m) else 0.0

    def late_share(self) -> Float[np.ndarray, " cameras"]:
        """Share of the squares of each camera's distances that its delay explains."""
        deviations, shared = self._deviations, self._is_shared[:, :, None]
        by_delay = (deviations.delay_s[:, None] * np.linalg.norm(deviations.speed[:, 3:], axis=-1)) ** 2
        squares = by_delay + (deviations.step[:, :, 3:] ** 2).sum(-1)
        explained, total = ((shared[:, :, 0] * values).sum(1) for values in (by_delay, squares))
        return np.asarray(explained / np.maximum(total, np.finfo(float).tiny))

    def moving_ratio(self, number: int) -> float:
        """Ratio of a camera's distances while the board moves fast and while it moves slowly; NaN if not known."""
        speed_m_s = np.linalg.norm(self._deviations.speed[:, 3:], axis=-1)
        is_known = self._is_shared[number] & (speed_m_s > 0)
        if is_known.sum() < _MIN_KNOWN_SPEEDS:
            return float("nan")
        low, high = np.quantile(speed_m_s[is_known], [1 / 3, 2 / 3])
        distance_m = np.linalg.norm(self._deviations.total[number, :, 3:], axis=-1)
        slow, fast = distance_m[is_known & (speed_m_s <= low)], distance_m[is_known & (speed_m_s >= high)]
        return float(np.median(fast) / max(float(np.median(slow)), 1e-6))

    @property
    def _deviations(self) -> Deviations:
        if self.adjustment.deviations is None:
            raise ValueError("one camera has no deviations")
        return self.adjustment.deviations

    def last_covariance(self, number: int) -> Float[np.ndarray, "unknowns unknowns"]:
        """Covariance of the poses of the last boards: turns about their middles, and shifts, six numbers a board."""
        num_blocks = self.adjustment.structure.num_blocks
        return block_covariance(self.problem, self.adjustment, np.arange(num_blocks - number, num_blocks))


def adjust_board_rig(
    cameras: Sequence[Camera],
    root: int,
    boards: Sequence[Sequence[PlacedBoard]],
    board: Board,
    coefficients: Sequence[Sequence[int]] | None,
    speed: Float[np.ndarray, "boards 6"] | None = None,
) -> BoardFit:
    """Adjust cameras and boards together.

    Each camera may see a board at a pose of its own (``adjustment.deviations``): cameras are not exactly synchronous.

    ``root``: number of the camera that stays. ``boards``: instants at which the board has the same pose: usually one,
    and many where it lies still. ``coefficients``: numbers of each camera's distortion coefficients that may change;
    ``None``: the intrinsics are given, and stay. ``speed``: steps a second by which the boards move; ``None``: they are
    not known.
    """
    free, prior = parameters.none_free(len(cameras)), parameters.no_prior(len(cameras))
    free[:, parameters.EXTRINSICS] = True
    free[root, parameters.EXTRINSICS] = False
    if coefficients is not None:
        cameras = [_with_coefficients(camera) for camera in cameras]
        free[:, parameters.FOCAL] = free[:, parameters.PRINCIPAL] = True
        for number, chosen in enumerate(coefficients):
            if cameras[number].lens == "standard":
                free[number, parameters.DISTORTION][: len(_PLAUSIBLE)] = True
                prior[number, parameters.DISTORTION][: len(_PLAUSIBLE)] = _PLAUSIBLE
            free[number, [parameters.DISTORTION.start + k for k in chosen]] = True
            prior[number, [parameters.DISTORTION.start + k for k in chosen]] = np.inf
    if len(cameras) == 1:
        return _fit(cameras, free, prior, boards, board)
    deviations = first_deviations(
        _late_s(boards, len(cameras)), read_only(np.zeros((len(boards), 6)) if speed is None else speed)
    )
    return _fit(cameras, free, prior, boards, board, deviations)


def _with_coefficients(camera: Camera) -> Camera:
    """Camera with five coefficients at least, if its lens is of the standard model."""
    missing = len(_PLAUSIBLE) - len(camera.distortion)
    if camera.lens != "standard" or missing <= 0:
        return camera
    return replace(camera, distortion=read_only(np.pad(camera.distortion, (0, missing))))


def _late_s(boards: Sequence[Sequence[PlacedBoard]], num_cameras: int) -> Float[np.ndarray, "cameras boards"]:
    """Times of the cameras' views of each board after their mean; 0 for boards that lie still."""
    late_s = np.zeros((num_cameras, len(boards)))
    for number, (first, *others) in enumerate(boards):
        if first.time_s and not others:
            late_s[list(first.time_s), number] = np.array(list(first.time_s.values())) - first.mean_time_s
    return read_only(late_s)


def _fit(
    cameras: Sequence[Camera],
    free: parameters.Free,
    prior: parameters.Parameters,
    boards: Sequence[Sequence[PlacedBoard]],
    board: Board,
    deviations: Deviations | None = None,
) -> BoardFit:
    middle_m = board.corners_m.mean(0)
    bodies = RigidBodies(
        read_only(np.array([instants[0].root_from_board.rotation for instants in boards])),
        read_only(np.array([instants[0].root_from_board.apply(middle_m) for instants in boards])),
    )
    observations = _observations(boards, board.corners_m - middle_m)
    problem = AdjustmentProblem(tuple(cameras), free, prior, observations, Loss.CAUCHY)
    return BoardFit(problem, adjust(problem, bodies, deviations=deviations), middle_m)


def _observations(
    boards: Sequence[Sequence[PlacedBoard]], from_middle_m: Float[np.ndarray, "corners 3"]
) -> PointObservations:
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
        model_m.append(from_middle_m[seen])
        points_px.append(corners_px[seen])
    return PointObservations(
        np.concatenate(camera), np.concatenate(block), np.concatenate(model_m), np.concatenate(points_px)
    )
