"""Heatmap peaks and part affinity fields of one image, for networks of OpenPose's kind.

After Cao et al., "Realtime multi-person 2D pose estimation using part affinity fields" (CVPR 2017). Maps are coarser
than the network's input: cell 0 covers the first ``stride_px`` pixels.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Float32, Int, UInt8

from pipeline.core.data.detections import MapGrid
from pipeline.detection.letterbox import LetterBox
from pipeline.detection.registry import FieldGrid
from pipeline.geometry.fields import quantise

MIN_PEAK_SCORE = 0.05
"""Least score of a peak; lower peaks are noise in all networks."""

# Factor of the upsampling of heatmaps, and standard deviation of their smoothing in cells. The neighbouring cells tell
# the position of a maximum within its cell.
_UPSAMPLING = 4
_SMOOTHING_CELLS = 0.375
_NEIGHBOURHOOD = np.ones((7, 7), np.uint8)


@dataclass(frozen=True, slots=True, eq=False)
class ImageFields:
    """Peaks and part affinity fields of one image."""

    # Joint of each peak, its position in pixels of the image, and the heatmap's value, at most 1
    joint: Int[np.ndarray, " n"]
    points_px: Float[np.ndarray, "n 2"]
    score: Float[np.ndarray, " n"]
    # Unit vectors along each limb in x and y of the maps, as bytes; see ``pipeline.core.data.detections.PafFields``
    fields: UInt8[np.ndarray, "limbs 2 height width"]
    grid: MapGrid  # Positions of the fields' cells on the image


def grid_on_image(grid: FieldGrid, letterbox: LetterBox) -> MapGrid:
    """Grid of a network's maps on an image."""
    offset_px = letterbox.image_from_network((grid.stride_px - 1) / 2 - np.array(grid.shift_px))
    pitch_px = grid.stride_px / letterbox.scale
    return MapGrid(tuple(offset_px.tolist()), tuple(pitch_px.tolist()), letterbox.turn_deg)


def read_fields(
    heatmaps: Float32[np.ndarray, "joints height width"],
    pafs: Float32[np.ndarray, "channels height width"],
    grid: MapGrid,
    image_size_px: tuple[int, int],
    order: Int[np.ndarray, "limbs 2"],
) -> ImageFields:
    """Read peaks in pixels of the image, and quantised fields, from a network's maps.

    - ``heatmaps``: heatmap of each joint, without the background.
    - ``pafs``: channels of the part affinity fields.
    - ``grid``: positions of the maps' cells on the image.
    - ``image_size_px``: width and height of the image; peaks outside of it, in the padding, are left out.
    - ``order``: channels of each limb's x and y.
    """
    joint, cells, score = find_peaks(heatmaps)
    points_px = grid.image_from_map(cells)
    inside = ((points_px >= -0.5) & (points_px < np.array(image_size_px) - 0.5)).all(-1)
    return ImageFields(joint[inside], points_px[inside], score[inside], quantise(pafs[order]), grid)


def find_peaks(
    heatmaps: Float32[np.ndarray, "joints height width"],
) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n 2"], Float[np.ndarray, " n"]]:
    """Find the local maxima of heatmaps with subcell accuracy.

    Returns joint, position (x, y) in cells, and value (at most 1) of each peak, in order of joints, rows and columns.
    """
    peaks = [_find_peaks(heatmap) for heatmap in heatmaps]
    joint = np.repeat(np.arange(len(peaks)), [len(score) for _, score in peaks])
    score = np.concatenate([score for _, score in peaks])
    return joint, np.concatenate([cells for cells, _ in peaks]), np.minimum(score, 1.0)


def _find_peaks(heatmap: Float32[np.ndarray, "height width"]) -> tuple[np.ndarray, np.ndarray]:
    fine = cv2.resize(heatmap, None, fx=_UPSAMPLING, fy=_UPSAMPLING, interpolation=cv2.INTER_CUBIC)
    fine = cv2.GaussianBlur(fine, (0, 0), _SMOOTHING_CELLS * _UPSAMPLING)
    highest = (fine > MIN_PEAK_SCORE) & (fine == cv2.dilate(fine, _NEIGHBOURHOOD))
    row, column = np.divmod(np.flatnonzero(highest), fine.shape[1])
    # The first of equal neighbours is the peak.
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
    """Offset of the vertex of a parabola through three neighbours from the middle; 0 at the map's border (NaN)."""
    bend = before - 2 * here + after
    return np.where(bend < 0, 0.5 * (before - after) / np.where(bend < 0, bend, -1.0), 0.0).clip(-0.5, 0.5)
