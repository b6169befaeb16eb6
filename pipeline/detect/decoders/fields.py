"""What a network of OpenPose's kind says of one image: peaks of its heatmaps, and part affinity fields.

After Cao et al., "Realtime multi-person 2D pose estimation using part affinity fields" (CVPR 2017). Maps are coarser
than the network's input: cell 0 is the mean of its first ``stride_px`` pixels.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Float32, Int, UInt8

from pipeline.data import MapGrid
from pipeline.detect.letterbox import LetterBox
from pipeline.geometry.fields import quantise

MIN_PEAK_SCORE = 0.05
"""Peaks below are noise in any network."""

# Maps are looked at this much finer than they are, and smoothed by so much of a cell: where the maximum of a coarse map
# lies within its cell is known from the cells around.
_UPSAMPLING = 4
_SMOOTHING_CELLS = 0.375
_NEIGHBOURHOOD = np.ones((7, 7), np.uint8)


@dataclass(frozen=True, slots=True)
class FieldGrid:
    """How a network's maps lie on its input, and what its fields are worth.

    Parameters
    ----------
    stride_px
        Pixels of the input a cell.
    shift_px
        How far, in pixels of the input, the network marks things to the right of and below where they are.
    tau2
        Least connectivity score of two joints that belong together (Chen et al. 2020, eq. 2): the paper's 0.3 is its
        network's.
    """

    stride_px: int
    shift_px: tuple[float, float]
    tau2: float

    def on_image(self, letterbox: LetterBox) -> MapGrid:
        """Where the maps' cells lie on an image."""
        scale = letterbox.scale
        offset_px = ((self.stride_px - 1) / 2 - np.array(self.shift_px) + 0.5) / scale - 0.5
        return MapGrid(offset_px=tuple(offset_px.tolist()), pitch_px=tuple((self.stride_px / scale).tolist()))


@dataclass(frozen=True, slots=True, eq=False)
class ImageFields:
    """Peaks and part affinity fields of one image.

    Parameters
    ----------
    joint, points_px, score
        Of each peak: which joint, where in the image, and the heatmap's value, at most 1.
    fields
        A limb's unit vectors (x, y) where it lies, as bytes (``pipeline.data.PafFields``).
    grid
        Where the fields' cells lie on the image.
    """

    joint: Int[np.ndarray, " n"]
    points_px: Float[np.ndarray, "n 2"]
    score: Float[np.ndarray, " n"]
    fields: UInt8[np.ndarray, "limbs 2 height width"]
    grid: MapGrid


def read_fields(
    heatmaps: Float32[np.ndarray, "joints height width"],
    pafs: Float32[np.ndarray, "channels height width"],
    grid: MapGrid,
    image_size_px: tuple[int, int],
    order: Int[np.ndarray, "limbs 2"],
) -> ImageFields:
    """Turn a network's maps into peaks in an image's pixels and compact fields.

    Parameters
    ----------
    heatmaps
        One a joint, without the background.
    image_size_px
        Peaks outside, on the padding, are dropped.
    order
        Channels of each limb's x and y.
    """
    joint, cells, score = find_peaks(heatmaps)
    points_px = grid.image_from_map(cells)
    inside = ((points_px >= -0.5) & (points_px < np.array(image_size_px) - 0.5)).all(-1)
    return ImageFields(joint[inside], points_px[inside], score[inside], quantise(pafs[order]), grid)


def find_peaks(
    heatmaps: Float32[np.ndarray, "joints height width"],
) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n 2"], Float[np.ndarray, " n"]]:
    """Local maxima of heatmaps, finer than their cells.

    Returns
    -------
        Of each peak the joint, the place (x, y) in cells, and the value, at most 1; in order of joints, rows, columns.
    """
    found = [_peaks_of(heatmap) for heatmap in heatmaps]
    joint = np.repeat(np.arange(len(found)), [len(score) for _, score in found])
    score = np.concatenate([score for _, score in found])
    return joint, np.concatenate([cells for cells, _ in found]), np.minimum(score, 1.0)


def _peaks_of(heatmap: Float32[np.ndarray, "height width"]) -> tuple[np.ndarray, np.ndarray]:
    fine = cv2.resize(heatmap, None, fx=_UPSAMPLING, fy=_UPSAMPLING, interpolation=cv2.INTER_CUBIC)
    fine = cv2.GaussianBlur(fine, (0, 0), _SMOOTHING_CELLS * _UPSAMPLING)
    highest = (fine > MIN_PEAK_SCORE) & (fine == cv2.dilate(fine, _NEIGHBOURHOOD))
    row, column = np.divmod(np.flatnonzero(highest), fine.shape[1])
    # Of equal neighbours the first counts.
    near = np.maximum(np.abs(row[:, None] - row), np.abs(column[:, None] - column)) <= len(_NEIGHBOURHOOD) // 2
    first = ~np.tril(near, -1).any(-1)
    row, column = row[first], column[first]
    here = fine[row, column].astype(np.float64)
    around = np.pad(fine, 1, constant_values=np.nan)
    left, right = around[row + 1, column], around[row + 1, column + 2]
    above, below = around[row, column + 1], around[row + 2, column + 1]
    place = np.stack([column + _vertex(left, here, right), row + _vertex(above, here, below)], axis=-1)
    return (place + 0.5) / _UPSAMPLING - 0.5, here


def _vertex(before: np.ndarray, here: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Where the parabola through three neighbours is highest, from the middle one; 0 at the map's border (NaN)."""
    bend = before - 2 * here + after
    return np.where(bend < 0, 0.5 * (before - after) / np.where(bend < 0, bend, -1.0), 0.0).clip(-0.5, 0.5)
