"""Poses of a board in a camera: both solutions of a plane, and both numberings of an ambiguous chessboard."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from pipeline.calibration.board.board_adjustment import PlacedBoard
from pipeline.calibration.board.spec import Board
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera
from pipeline.core.data.rigid import Rigid3
from pipeline.geometry.undistortion import undistort_px

# Poses before and after an instant tell the speed if they are at most this far apart.
_MAX_SPAN_S = 0.6


@dataclass(frozen=True, slots=True, eq=False)
class BoardMotion:
    """Board at the instants at which it can be placed, ascending."""

    time_s: Float[np.ndarray, " instants"]
    boards: Sequence[PlacedBoard]  # Numbered alike at all instants
    middle_m: Float[np.ndarray, " 3"]  # Middle of the board, in its frame

    def speed_at(self, time_s: float) -> Float[np.ndarray, " 6"]:
        """Turn about the board's middle and shift of it in a second; 0 where no poses just before and after tell."""
        before = int(np.searchsorted(self.time_s, time_s, "left")) - 1
        after = int(np.searchsorted(self.time_s, time_s, "right"))
        if before < 0 or after >= len(self.time_s) or self.time_s[after] - self.time_s[before] > _MAX_SPAN_S:
            return np.zeros(6)
        span_s = self.time_s[after] - self.time_s[before]
        first, last = self.boards[before].root_from_board, self.boards[after].root_from_board
        turn = Rotation.from_matrix(last.rotation @ first.rotation.T).as_rotvec() / span_s
        middle_m_s = (last.apply(self.middle_m) - first.apply(self.middle_m)) / span_s
        return np.concatenate([turn, middle_m_s])


# The second solution counts while its error is below this multiple of the first one's, and below this one in pixels.
_AMBIGUOUS_RATIO, _AMBIGUOUS_PX = 4.0, 1.0

# A plane with fewer corners has no pose.
_MIN_CORNERS = 4


def possible_poses(camera: Camera, corners_px: Float[np.ndarray, "corners 2"], board: Board) -> list[Rigid3]:
    """Poses ``cam_from_board`` that explain a view, the best first (infinitesimal plane-based pose estimation).

    A plane that is seen from far away has two poses of nearly equal error (Collins and Bartoli 2014). The corners of an
    ambiguous chessboard may be numbered from the other end.
    """
    candidates = []
    for numbered in (corners_px, corners_px[::-1]) if board.is_ambiguous else (corners_px,):
        candidates += _solutions(camera, numbered, board)
    candidates.sort(key=lambda candidate: candidate[0])
    best_px = candidates[0][0] if candidates else 0.0
    limit_px = max(_AMBIGUOUS_RATIO * best_px, _AMBIGUOUS_PX)
    return [pose for error_px, pose in candidates if error_px <= limit_px]


def _solutions(camera: Camera, corners_px: np.ndarray, board: Board) -> list[tuple[float, Rigid3]]:
    seen = np.isfinite(corners_px).all(-1)
    points_m, points_px = board.corners_m[seen], corners_px[seen]
    distortion = camera.distortion if len(camera.distortion) else np.zeros(4)
    if camera.lens == "fisheye":  # OpenCV's functions know the standard model alone
        points_px, distortion = undistort_px(camera, points_px), np.zeros(4)
        is_in_view = np.isfinite(points_px).all(-1)
        points_m, points_px = points_m[is_in_view], points_px[is_in_view]
        if len(points_m) < _MIN_CORNERS:
            return []
    # IPPE takes the middle of the points for the plane's origin; other origins are numerically worse.
    middle_m = points_m.mean(0)
    _, turns, shifts, errors = cv2.solvePnPGeneric(
        points_m - middle_m, points_px, camera.matrix, distortion, flags=cv2.SOLVEPNP_IPPE
    )
    poses = []
    for turn, shift_m, _ in zip(turns, shifts, np.ravel(errors), strict=True):
        refined = cv2.solvePnPRefineLM(points_m - middle_m, points_px, camera.matrix, distortion, turn, shift_m)
        rotation = cv2.Rodrigues(refined[0])[0].astype(float)
        translation_m = refined[1].ravel() - rotation @ middle_m
        if translation_m[2] + (rotation @ middle_m)[2] <= 0:
            continue
        projected, _ = cv2.projectPoints(points_m - middle_m, *refined, camera.matrix, distortion)
        error_px = float(np.sqrt(((projected.reshape(-1, 2) - points_px) ** 2).sum(-1).mean()))
        poses.append((error_px, Rigid3(read_only(rotation), read_only(translation_m))))
    return poses
