"""Corners between the squares of a board as a grid, found without its markers.

A corner between four squares is a saddle of the brightness, and remains one in pictures too blurred, noisy or small
for the bits of a marker. A grid grows from saddle to saddle (Geiger et al. 2012, "Automatic camera and range sensor
calibration using a single shot"); saddles inside markers do not continue a grid.
"""

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
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
# Strength of a corner, as a share of the strength of the corner from which the grid grows: corners of a board are
# alike.
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
# Steps to the cells around from which the place of the next one is predicted, two each way.
_STEPS = tuple((x, y) for x in range(-2, 3) for y in range(-2, 3) if (x, y) != (0, 0))
# Sets of such cells whose equations are kept: grids meet the same ones again and again.
_MAX_CONTINUATIONS = 4096
# Distance from a homography of the whole grid, in squares, from which on a saddle is no corner of the board.
_HOMOGRAPHY_SQUARES = 0.2

_NONE = -1  # Number of no saddle

_Cell = tuple[int, int]
_Numbers = int | Int[np.ndarray, "..."]


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
    """Find grids of corners, at least three each way: grids of large pictures first, of each the largest first."""
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
    grown: list[dict[_Cell, int]] = []
    used: set[int] = set()
    for seed, (right, down) in enumerate(_beside_seeds(saddles).tolist()):
        if seed in used or _NONE in (right, down):
            continue
        cells = _grown(saddles, {(0, 0): seed, (1, 0): right, (0, 1): down})
        if len(cells) >= _MIN_SIDE**2:
            grown.append(cells)
            used |= set(cells.values())
    return sorted(grown, key=len, reverse=True)[:_MAX_GRIDS]


def _beside_seeds(saddles: _Saddles) -> Int[np.ndarray, "seeds 2"]:
    """Saddle next to each seed along each of its two edges, either way: the nearest whose squares are exchanged.

    ``_NONE`` where there is none.
    """
    num_seeds, xy_px = _NUM_SEEDS, saddles.xy_px
    distance_px, number = KDTree(xy_px).query(xy_px[:num_seeds], min(_NUM_NEIGHBOURS, len(xy_px)))
    distance_px, number = distance_px[:, 1:], number[:, 1:]  # a seed is its own nearest saddle
    edges, strength = saddles.edges[:num_seeds], saddles.strength[:num_seeds]
    along, across = edges[:, :1], edges[:, 1:]
    # Neighbours are dark on the side on which the seed is bright.
    wanted = -_side(saddles, np.arange(len(edges))[:, None], along, across)
    is_next = wanted * _agreement(saddles, number, along, across) >= _MIN_AGREEMENT
    is_next &= saddles.strength[number] >= _MIN_STRENGTH * strength[:, None]
    towards_px = np.abs(np.einsum("skx,sex->sek", xy_px[number] - xy_px[:num_seeds, None], edges))
    is_next = is_next[:, None] & (towards_px >= _MIN_COSINE * distance_px[:, None])
    nearest = np.take_along_axis(number[:, None], is_next.argmax(-1)[..., None], axis=-1)[..., 0]
    return np.where(is_next.any(-1), nearest, _NONE)


def _grown(saddles: _Saddles, cells: dict[_Cell, int]) -> dict[_Cell, int]:
    """Grow a grid from a saddle at (0, 0) and those beside it."""
    xy_px, seed = saddles.xy_px, cells[0, 0]
    sign = float(_side(saddles, seed, *saddles.edges[seed]))
    used = set(cells.values())
    waiting = deque(_around(cells, list(cells)))
    while waiting:
        cell = waiting.popleft()
        if cell in cells or (expected := _expected(xy_px, cells, cell)) is None:
            continue
        place_px, along, across = expected
        off_px = xy_px - place_px
        number = int(np.einsum("sx,sx->s", off_px, off_px).argmin())
        side_px = min(math.hypot(*along), math.hypot(*across))
        if math.hypot(*off_px[number]) > _MAX_MISS_SQUARES * side_px or number in used:
            continue
        if saddles.strength[number] < _MIN_STRENGTH * saddles.strength[seed]:
            continue
        wanted = sign if sum(cell) % 2 == 0 else -sign
        if wanted * _agreement(saddles, number, along, across) < _MIN_AGREEMENT:
            continue
        cells[cell] = number
        used.add(number)
        waiting.extend(_around(cells, [cell]))
    return cells


def _around(cells: dict[_Cell, int], some: list[_Cell]) -> list[_Cell]:
    """Cells beside some cells that have no saddle yet."""
    beside = [(x + dx, y + dy) for x, y in some for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1))]
    return [cell for cell in beside if cell not in cells]


def _curvature(saddles: _Saddles, number: _Numbers, along: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Mixed second derivative of saddles along two directions of the last axis."""
    hessian = saddles.hessian[number]
    mixed = along[..., 0] * across[..., 1] + along[..., 1] * across[..., 0]
    xx, yy = along[..., 0] * across[..., 0], along[..., 1] * across[..., 1]
    return np.asarray(hessian[..., 0, 0] * xx + hessian[..., 0, 1] * mixed + hessian[..., 1, 1] * yy)


def _side(saddles: _Saddles, number: _Numbers, along: np.ndarray, across: np.ndarray) -> np.ndarray:
    return np.sign(_curvature(saddles, number, along, across))


def _agreement(saddles: _Saddles, number: _Numbers, along: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Agreement of saddles' edges with steps of a grid: 1 or -1 where they run along it, 0 where they are turned.

    The sign tells the side on which a saddle is bright. The last axis of the steps is x and y.
    """
    area = np.abs(along[..., 0] * across[..., 1] - along[..., 1] * across[..., 0])
    is_grid = area >= _MIN_SINE * np.hypot(along[..., 0], along[..., 1]) * np.hypot(across[..., 0], across[..., 1])
    curvature = _curvature(saddles, number, along, across)
    return np.where(is_grid, curvature / (saddles.strength[number] * np.where(is_grid, area, 1.0)), 0.0)


def _expected(
    xy_px: Float[np.ndarray, "saddles 2"], cells: dict[_Cell, int], cell: _Cell
) -> Float[np.ndarray, "3 2"] | None:
    """Place of a cell's corner as the cells around it continue, and the steps along a row and down a column there."""
    x, y = cell
    near = tuple(step for step in _STEPS if (x + step[0], y + step[1]) in cells)
    if (continued := _continuation(near)) is None:
        return None
    return continued @ xy_px[[cells[x + dx, y + dy] for dx, dy in near]]


@lru_cache(_MAX_CONTINUATIONS)
def _continuation(near: tuple[_Cell, ...]) -> Float[np.ndarray, "3 near"] | None:
    """Matrix from corners this many cells away to a cell's corner and its steps; ``None`` if they are on one line."""
    design = np.array([(1.0, *step) for step in near])
    return np.linalg.pinv(design) if len(near) >= 3 and np.linalg.matrix_rank(design) == 3 else None


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
