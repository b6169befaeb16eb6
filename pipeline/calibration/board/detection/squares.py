"""Corners between the squares of a board as a grid, found without its markers.

A corner between four squares is a saddle of the brightness, and remains one in pictures too blurred, noisy or small
for the bits of a marker. A grid grows from saddle to saddle (Geiger et al. 2012, "Automatic camera and range sensor
calibration using a single shot"); saddles inside markers do not continue a grid.
"""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy.spatial import KDTree

# Sides of the searched pictures as shares of the largest: squares of 8 to 80 pixels are small enough in one of them.
_LARGEST_PX, _SHRUNK = 1280, (1.0, 0.7, 0.5, 0.36, 0.25)
_SMOOTHING_PX = 1.6
# Contrast of a saddle, of 255, and the number of saddles that are kept, the strongest.
_MIN_CONTRAST, _MAX_SADDLES = 12.0, 600
# Strongest saddles from which grids are grown.
_NUM_SEEDS = 48
# Strength of a corner, as a share of that of the corner from which the grid grows: corners of a board are alike.
_MIN_STRENGTH = 0.4
# Grids of a picture, the largest: one is the board, others are of bits or of the background.
_MAX_GRIDS = 3
# Neighbours among which the next corner along an edge is looked for, and its direction's tolerance as a cosine.
_NUM_NEIGHBOURS, _MIN_COSINE = 16, 0.94
# A saddle continues a grid this close to the prediction, in squares, if its edges are turned little from the grid's.
_MAX_MISS_SQUARES, _MIN_AGREEMENT = 0.28, 0.6
# A grid has at least three corners each way, so that a homography fits by evidence.
_MIN_SIDE = 3
# Steps along a row and a column that are nearly parallel tell no grid.
_MIN_SINE = 0.05
# Cells around, each way, from which the place of the next one is predicted.
_AROUND = 2
# Distance from a homography of the whole grid, in squares, from which on a saddle is no corner of the board.
_HOMOGRAPHY_SQUARES = 0.2

_Cell = tuple[int, int]


class _Saddles(NamedTuple):
    """Saddles of a picture, the strongest first: places, second derivatives, their size, directions of their edges."""

    xy_px: Float[np.ndarray, "saddles 2"]
    hessian: Float[np.ndarray, "saddles 2 2"]
    strength: Float[np.ndarray, " saddles"]
    edges: Float[np.ndarray, "saddles 2 2"]


@dataclass(frozen=True, slots=True, eq=False)
class SquareGrid:
    """Corners between squares on a grid of which neither the origin nor the direction is known."""

    # Pixels by row and column, NaN where no corner was found. Columns run to the right of rows, seen from in front.
    corners_px: Float[np.ndarray, "rows columns 2"]
    picture_from_grid: Float[np.ndarray, "3 3"]  # Homography from columns and rows to pixels

    @property
    def is_found(self) -> Bool[np.ndarray, "rows columns"]:
        """Places at which a corner was found."""
        return np.isfinite(self.corners_px).all(-1)


def find_grids(gray: UInt8[np.ndarray, "height width"]) -> Iterator[SquareGrid]:
    """Find grids of corners, at least three each way: those of large pictures first, of each the largest first."""
    for shrunk in _SHRUNK:
        factor = min(1.0, _LARGEST_PX / max(gray.shape)) * shrunk
        small = cv2.resize(gray, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA) if factor < 1.0 else gray
        if (saddles := _saddles(small)) is None:
            continue
        for cells in _separate(saddles):
            if (grid := _grid(saddles, cells, factor)) is not None:
                yield grid


def _saddles(gray: UInt8[np.ndarray, "height width"]) -> _Saddles | None:
    """Saddles of a picture; ``None`` if there are too few for a grid."""
    smooth = cv2.GaussianBlur(gray.astype(np.float32), (0, 0), _SMOOTHING_PX)
    second, none, slope = np.array([1.0, -2.0, 1.0]), np.array([0.0, 1.0, 0.0]), np.array([-0.5, 0.0, 0.5])
    xx, yy = cv2.sepFilter2D(smooth, -1, second, none), cv2.sepFilter2D(smooth, -1, none, second)
    xy = cv2.sepFilter2D(smooth, -1, slope, slope)
    squared = xy * xy - xx * yy
    # The second derivative of two crossing edges that are blurred by a Gaussian is contrast / (pi variance).
    least = (_MIN_CONTRAST / (np.pi * _SMOOTHING_PX**2)) ** 2
    is_peak = (squared >= cv2.dilate(squared, np.ones((5, 5), np.uint8))) & (squared > least)
    y, x = np.nonzero(is_peak)
    order = np.argsort(-squared[y, x], kind="stable")[:_MAX_SADDLES]
    if len(order) < _MIN_SIDE**2:
        return None
    y, x = y[order], x[order]
    hessian = np.stack([xx[y, x], xy[y, x], xy[y, x], yy[y, x]], axis=-1).reshape(-1, 2, 2).astype(float)
    curvature, axes = np.linalg.eigh(hessian)
    # Along its edges a saddle is flat.
    dark, bright = np.sqrt(curvature[:, 1:]) * axes[:, :, 0], np.sqrt(-curvature[:, :1]) * axes[:, :, 1]
    edges = np.stack([dark + bright, dark - bright], axis=1)
    edges /= np.linalg.norm(edges, axis=-1, keepdims=True)
    return _Saddles(np.column_stack([x, y]).astype(float), hessian, np.sqrt(squared[y, x]), edges)


def _separate(saddles: _Saddles) -> list[dict[_Cell, int]]:
    """Grids that grow from the strongest saddles, the largest first: saddles by column and row."""
    tree = KDTree(saddles.xy_px)
    grown: list[dict[_Cell, int]] = []
    used: set[int] = set()
    for seed in range(min(_NUM_SEEDS, len(saddles.xy_px))):
        if seed in used:
            continue
        cells = _grown(saddles, tree, seed)
        if len(cells) >= _MIN_SIDE**2:
            grown.append(cells)
            used |= set(cells.values())
    return sorted(grown, key=len, reverse=True)[:_MAX_GRIDS]


def _grown(saddles: _Saddles, tree: KDTree, seed: int) -> dict[_Cell, int]:
    """Grow a grid from a saddle."""
    along, across = saddles.edges[seed]
    sign = float(np.sign(along @ saddles.hessian[seed] @ across))
    right = _next(saddles, tree, seed, along, across)
    down = _next(saddles, tree, seed, across, along)
    if right is None or down is None:
        return {}
    cells: dict[_Cell, int] = {(0, 0): seed, (1, 0): right, (0, 1): down}
    used = set(cells.values())
    waiting = deque(_around(cells, list(cells)))
    while waiting:
        cell = waiting.popleft()
        if cell in cells or (expected := _expected(saddles.xy_px, cells, cell)) is None:
            continue
        place_px, along, across = expected
        side_px = min(np.linalg.norm(along), np.linalg.norm(across))
        distance_px, number = tree.query(place_px)
        if distance_px > _MAX_MISS_SQUARES * side_px or number in used:
            continue
        if saddles.strength[number] < _MIN_STRENGTH * saddles.strength[seed]:
            continue
        wanted = sign if sum(cell) % 2 == 0 else -sign
        if wanted * _agreement(saddles, int(number), along, across) < _MIN_AGREEMENT:
            continue
        cells[cell] = int(number)
        used.add(int(number))
        waiting.extend(_around(cells, [cell]))
    return cells


def _around(cells: dict[_Cell, int], some: list[_Cell]) -> list[_Cell]:
    """Cells beside some cells that have no saddle yet."""
    beside = [(x + dx, y + dy) for x, y in some for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1))]
    return [cell for cell in beside if cell not in cells]


def _next(saddles: _Saddles, tree: KDTree, seed: int, along: np.ndarray, across: np.ndarray) -> int | None:
    """Nearest saddle along an edge, either way, whose dark squares are where those of the seed are bright."""
    wanted = -np.sign(along @ saddles.hessian[seed] @ across)
    distances_px, numbers = tree.query(saddles.xy_px[seed], min(_NUM_NEIGHBOURS, len(saddles.xy_px)))
    for distance_px, number in zip(distances_px[1:], numbers[1:], strict=True):
        towards = saddles.xy_px[number] - saddles.xy_px[seed]
        if abs(towards @ along) < _MIN_COSINE * distance_px:
            continue
        if saddles.strength[number] < _MIN_STRENGTH * saddles.strength[seed]:
            continue
        if wanted * _agreement(saddles, int(number), along, across) >= _MIN_AGREEMENT:
            return int(number)
    return None


def _agreement(saddles: _Saddles, number: int, along: np.ndarray, across: np.ndarray) -> float:
    """Agreement of a saddle's edges with steps of a grid: 1 or -1 where they run along it, 0 where they are turned.

    The sign tells the side on which the saddle is bright.
    """
    area = abs(along[0] * across[1] - along[1] * across[0])
    if area < _MIN_SINE * np.linalg.norm(along) * np.linalg.norm(across):
        return 0.0
    return float(along @ saddles.hessian[number] @ across / (saddles.strength[number] * area))


def _expected(
    xy_px: Float[np.ndarray, "saddles 2"], cells: dict[_Cell, int], cell: _Cell
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Place of a cell's corner as the cells around it continue, and the steps along a row and down a column there."""
    x, y = cell
    near = [(a - x, b - y, number) for (a, b), number in cells.items() if max(abs(a - x), abs(b - y)) <= _AROUND]
    if len(near) < 3:
        return None
    design = np.array([(1.0, a, b) for a, b, _ in near])
    solution, _, rank, _ = np.linalg.lstsq(design, xy_px[[number for *_, number in near]], rcond=1e-9)
    return (solution[0], solution[1], solution[2]) if rank == 3 else None


def _grid(saddles: _Saddles, cells: dict[_Cell, int], factor: float) -> SquareGrid | None:
    """Cells as an array in pixels of the full picture, without those that a homography does not explain."""
    at = np.array(list(cells))
    at -= at.min(0)
    xy_px = (saddles.xy_px[list(cells.values())] + 0.5) / factor - 0.5
    grid_px = np.full((*(at.max(0) + 1)[::-1], 2), np.nan)
    grid_px[at[:, 1], at[:, 0]] = xy_px
    if _is_left_handed(at, xy_px):
        grid_px = grid_px[:, ::-1]
    row, column = np.nonzero(np.isfinite(grid_px).all(-1))
    points_px = grid_px[row, column]
    side_px = np.sqrt(np.median([np.nanmedian(np.linalg.norm(np.diff(grid_px, axis=k), axis=-1)) ** 2 for k in (0, 1)]))
    homography, is_inlier = cv2.findHomography(
        np.column_stack([column, row]).astype(float), points_px, cv2.RANSAC, _HOMOGRAPHY_SQUARES * side_px
    )
    if homography is None or is_inlier.sum() < _MIN_SIDE**2:
        return None
    is_outlier = is_inlier.ravel() == 0
    grid_px[row[is_outlier], column[is_outlier]] = np.nan
    return SquareGrid(grid_px, np.asarray(homography, float))


def _is_left_handed(at: Int[np.ndarray, "cells 2"], xy_px: Float[np.ndarray, "cells 2"]) -> bool:
    """Return whether rows run to the left of columns in the picture."""
    design = np.column_stack([np.ones(len(at)), at])
    return bool(np.linalg.det(np.linalg.lstsq(design, xy_px, rcond=None)[0][1:]) < 0)
