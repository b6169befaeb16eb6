"""Views of a board as exact projections with noise."""

from collections.abc import Sequence

import numpy as np

from pipeline.calibration.board.spec import Board
from pipeline.calibration.board.views import BoardViews
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera
from pipeline.core.data.rigid import Rigid3
from pipeline.geometry.camera import center_in_world, project
from pipeline.validation.simulation.rigs import Layout, Rig, build_cameras


def ring(num_cameras: int) -> tuple[Camera, ...]:
    return tuple(build_cameras(Rig(Layout.RING, num_cameras, (3.0, 2.5), 2.0), np.random.default_rng(0)))


def views_of(
    cameras: Sequence[Camera],
    board: Board,
    times_s: np.ndarray,
    poses: Sequence[Rigid3],
    rng: np.random.Generator,
    noise_px: float = 0.2,
) -> list[BoardViews]:
    """Corners that cameras see of a board that faces them; an ambiguous board is numbered from either end."""
    found = []
    for camera in cameras:
        seen_s, corners = [], []
        for time_s, pose in zip(times_s, poses, strict=True):
            corners_px = project(camera, pose.apply(board.corners_m)) + rng.normal(0, noise_px, (board.num_corners, 2))
            towards = center_in_world(camera) - pose.translation_m
            inside = ((corners_px >= 0) & (corners_px <= np.array(camera.size_px) - 1)).all(-1)
            is_seen = inside.all() if board.kind == "chessboard" else inside.sum() >= 8
            if -pose.rotation[:, 2] @ towards < 0.25 * np.linalg.norm(towards) or not is_seen:
                continue
            corners_px[~inside] = np.nan
            seen_s.append(time_s)
            corners.append(corners_px[::-1] if board.is_ambiguous and rng.random() < 0.5 else corners_px)
        found.append(
            BoardViews(
                camera.name,
                camera.size_px,
                read_only(np.array(seen_s)),
                read_only(np.array(corners)),
                read_only(np.ones(len(corners))),
                len(times_s),
            )
        )
    return found
