"""Pictures of a board that cameras film, with blur, noise and partial views."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from scipy.spatial.transform import Rotation

from pipeline.calibration.board.spec import Board, draw_pattern
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera
from pipeline.core.data.rigid import Rigid3
from pipeline.geometry.camera import center_in_world, project
from pipeline.geometry.undistortion import undistort_px

_TEXEL_M = 0.001
_BACKGROUND, _BLACK, _WHITE = 96.0, 24.0, 224.0
# Pictures are drawn this many times finer and shrunk.
_SUPERSAMPLING = 2
# Names of the axes: x of the board to the right, y down, z away from the viewer.
_FLOOR = Rigid3(read_only(np.diag([1.0, -1.0, -1.0])), read_only(np.zeros(3)))


def board_texture(board: Board) -> tuple[UInt8[np.ndarray, "height width"], Float[np.ndarray, " 2"]]:
    """Draw a board, a texel a millimetre, with a margin of a square; and the place of its origin in texels."""
    square = round(board.square_m / _TEXEL_M)
    first = 1 if board.kind == "charuco" else 2
    origin = np.array([first * square, first * square])
    return np.pad(draw_pattern(board, square), square, constant_values=board.margin_shade), origin - 0.5


class BoardPainter:
    """Painter of a board in the pictures of one camera.

    Parameters
    ----------
    blur_px
        Standard deviation of the lens's blur.
    noise
        Standard deviation of the sensor's noise, of 255.
    """

    def __init__(self, camera: Camera, board: Board, blur_px: float = 0.7, noise: float = 3.0) -> None:
        self._camera, self._blur_px, self._noise = camera, blur_px, noise
        texture, self._origin = board_texture(board)
        shaded = _BLACK + (_WHITE - _BLACK) * texture.astype(np.float32) / 255
        # Coarser copies, so that a distant board has no aliases.
        self._textures = [shaded]
        while min(self._textures[-1].shape) > 64:
            coarser = cv2.resize(self._textures[-1], None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
            self._textures.append(np.asarray(coarser, np.float32))
        self._rays = _fine_rays(camera)
        # The board lies or is held still for many pictures, which differ by their noise alone.
        self._last: tuple[Rigid3, Float[np.ndarray, "height width"]] | None = None

    def paint(self, world_from_board: Rigid3, rng: np.random.Generator) -> UInt8[np.ndarray, "height width 3"]:
        """Paint the board at a pose, in front of a grey wall; from behind it is not painted."""
        if self._last is None or self._last[0] is not world_from_board:
            self._last = world_from_board, self._blurred(world_from_board)
        blurred = self._last[1]
        noisy = blurred + rng.normal(0.0, self._noise, blurred.shape)
        gray = np.clip(np.round(noisy), 0, 255).astype(np.uint8)
        return np.repeat(gray[..., None], 3, axis=-1)

    def _blurred(self, world_from_board: Rigid3) -> Float[np.ndarray, "height width"]:
        """Shades of a picture without noise."""
        width, height = self._camera.size_px
        image = np.full((height, width), _BACKGROUND, np.float32)
        towards = center_in_world(self._camera) - world_from_board.translation_m
        if -world_from_board.rotation[:, 2] @ towards > 0 and (window := self._window(world_from_board)) is not None:
            image[window] = self._shades(world_from_board, window)
        return np.asarray(cv2.GaussianBlur(image, (0, 0), self._blur_px))

    def _window(self, world_from_board: Rigid3) -> tuple[slice, slice] | None:
        """Rows and columns around the board; ``None`` if it is not in the picture."""
        rows, columns = self._textures[0].shape
        edge = np.linspace(0.0, 1.0, 9)
        across, down = np.meshgrid(edge * columns, edge * rows)
        texels = np.column_stack([across.ravel(), down.ravel()]) - self._origin
        points_m = np.column_stack([texels * _TEXEL_M, np.zeros(len(texels))])
        points_px = project(self._camera, world_from_board.apply(points_m))
        if not np.isfinite(points_px).all():
            return None
        low = np.maximum(np.floor(points_px.min(0)).astype(int) - 4, 0)
        high = np.minimum(np.ceil(points_px.max(0)).astype(int) + 5, self._camera.size_px)
        return None if (high <= low).any() else (slice(low[1], high[1]), slice(low[0], high[0]))

    def _shades(self, world_from_board: Rigid3, window: tuple[slice, slice]) -> Float[np.ndarray, "rows columns"]:
        """Shades in a window of the picture: rays meet the board's plane."""
        fine = _SUPERSAMPLING
        rays = self._rays[tuple(slice(one.start * fine, one.stop * fine) for one in window)]
        cam_from_board = self._camera.cam_from_world @ world_from_board
        normal, point_m = cam_from_board.rotation[:, 2], cam_from_board.translation_m
        with np.errstate(divide="ignore", invalid="ignore"):
            depth_m = (normal @ point_m) / (rays @ normal)
            on_board_m = (rays * depth_m[..., None] - point_m) @ cam_from_board.rotation[:, :2]
        footprint = np.linalg.norm(point_m) / self._camera.matrix[0, 0] / fine / _TEXEL_M
        level = int(np.clip(np.floor(np.log2(max(footprint, 1.0))), 0, len(self._textures) - 1))
        texels = (on_board_m / _TEXEL_M + self._origin + 0.5) * 2.0**-level - 0.5
        texels[~np.isfinite(texels).all(-1) | (depth_m <= 0)] = -1e6
        x, y = np.moveaxis(texels.astype(np.float32), -1, 0)
        shades = cv2.remap(
            self._textures[level], x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=_BACKGROUND
        )
        rows, columns = (one.stop - one.start for one in window)
        return np.asarray(cv2.resize(shades, (columns, rows), interpolation=cv2.INTER_AREA))


def _fine_rays(camera: Camera) -> Float[np.ndarray, "rows columns 3"]:
    """Rays of the pixels of a finer picture, interpolated between the picture's own pixels: they change slowly."""
    width, height = camera.size_px
    grid = np.stack(np.meshgrid(np.arange(-1.0, width + 1), np.arange(-1.0, height + 1)), axis=-1)
    ideal_px = undistort_px(camera, grid.reshape(-1, 2)).reshape(height + 2, width + 2, 2)
    fine = _SUPERSAMPLING
    ideal_px = cv2.resize(ideal_px, None, fx=fine, fy=fine, interpolation=cv2.INTER_LINEAR)[fine:-fine, fine:-fine]
    return np.concatenate([ideal_px, np.ones_like(ideal_px[..., :1])], axis=-1) @ np.linalg.inv(camera.matrix).T


def board_poses(
    cameras: Sequence[Camera], board: Board, num_poses: int, rng: np.random.Generator
) -> tuple[Float[np.ndarray, " instants"], list[Rigid3]]:
    """Times and poses of a board: a second on the floor, then held still towards one camera after the other.

    Returns
    -------
        Times in seconds, 0.04 apart while it lies or is held still, and the transforms from the board to the world.
    """
    times_s, poses = [k * 0.04 for k in range(15)], [_FLOOR] * 15
    middle_m = board.corners_m.mean(0)
    for k in range(num_poses):
        camera = cameras[k % len(cameras)]
        place_m = rng.uniform([-1.0, -1.0, 0.4], [1.0, 1.0, 1.6])
        away = place_m - center_in_world(camera)
        away /= np.linalg.norm(away)
        down = np.array([0.0, 0.0, -1.0]) + away * away[2]
        down /= np.linalg.norm(down)
        facing = np.column_stack([np.cross(down, away), down, away])
        rotation = facing @ Rotation.from_rotvec(rng.normal(0.0, 0.45, 3)).as_matrix()
        pose = Rigid3(read_only(rotation), read_only(place_m - rotation @ middle_m))
        times_s += [1.0 + 0.4 * k, 1.04 + 0.4 * k]
        poses += [pose, pose]
    return np.array(times_s), poses
