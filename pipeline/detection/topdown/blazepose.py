"""BlazePose: crops of bodies, and its landmarks from a network's outputs.

BlazePose (Bazarevsky et al., CV4ARXR 2020) regresses 33 landmarks in the crop of one body and outputs a heatmap of
each. A cell of a heatmap is 4 pixels wide. The outputs count from the crop's edge, as a mirrored crop shows: the
horizontal positions of a landmark in a crop and in its mirror image add up to 256, where positions of pixel centres
would add up to 255.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from pipeline.core.joints import COCO_17
from pipeline.detection.topdown.regions import Region, upward

CROP_PX = 256
SURE_PEAK = 0.5
"""Least peak of a heatmap: three in five landmarks are right at a peak of 0.5, one in four at 0.4."""
# A peak is that much higher than the score that MultiPose gives to joints of the same quality.
_SCORE_BELOW_PEAK = 0.1

LANDMARKS = (
    "nose",
    "left_eye_inner",
    "left_eye",
    "left_eye_outer",
    "right_eye_inner",
    "right_eye",
    "right_eye_outer",
    "left_ear",
    "right_ear",
    "mouth_left",
    "mouth_right",
    "left_shoulder",
    "right_shoulder",
    "left_elbow",
    "right_elbow",
    "left_wrist",
    "right_wrist",
    "left_pinky",
    "right_pinky",
    "left_index",
    "right_index",
    "left_thumb",
    "right_thumb",
    "left_hip",
    "right_hip",
    "left_knee",
    "right_knee",
    "left_ankle",
    "right_ankle",
    "left_heel",
    "right_heel",
    "left_foot_index",
    "right_foot_index",
)
LANDMARK = {name: index for index, name in enumerate(LANDMARKS)}
"""Position of each landmark by name."""

_NUM_OUTPUTS = 39  # with landmarks that are not used
_CELL_PX = 4
# Least score of the joints that give a region, and their least number.
_MIN_SCORE, _MIN_JOINTS = 0.2, 5
# The circle around a body is so much larger than the circle around its joints: the top of the head, toes.
_BODY_RADIUS = 1.1
# Side of the crop in radii of the circle around the body.
_SIDE = 2.5
# A trunk that is shorter in the image, in radii, has no certain direction.
_MIN_TRUNK = 0.15
# In smaller bodies the landmarks are less certain than the joints of the detector of bodies.
_MIN_BODY_PX = 40.0

_HIPS, _SHOULDERS = (COCO_17.indices((f"left_{kind}", f"right_{kind}")) for kind in ("hip", "shoulder"))
_REACH_CELLS = 3
"""Cells of the window on each side of its central cell: the window of MediaPipe, 7 x 7."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseOutputs:
    """Outputs of BlazePose for the crop of one body."""

    regressed_px: Float[np.ndarray, "landmarks 2"]  # Regressed landmarks in pixels of the image
    logits: Float[np.ndarray, "landmarks height width"]  # Heatmaps before the sigmoid
    region: Region  # Region of the crop

    def near(
        self, expected_px: Float[np.ndarray, "landmarks 2"]
    ) -> tuple[Float[np.ndarray, "landmarks 2"], Float[np.ndarray, " landmarks"]]:
        """Read landmarks near expected positions in the image.

        Returns pixels of the image and peaks in [0, 1]; NaN and 0 where the expected position is NaN or outside of the
        crop.
        """
        cells = (self.region.crop_from_image(expected_px, CROP_PX) + 0.5) / _CELL_PX
        read_cells, peak = read_near(self.logits, cells)
        return self.region.image_from_crop(_from_center(read_cells * _CELL_PX), CROP_PX), peak

    def refined(self) -> tuple[Float[np.ndarray, "landmarks 2"], Float[np.ndarray, " landmarks"]]:
        """Read landmarks near their regressed positions; without a sure heatmap there, they stay where they are.

        Returns pixels of the image and peaks in [0, 1].
        """
        read_px, peak = self.near(self.regressed_px)
        return np.where(peak[:, None] >= SURE_PEAK, read_px, self.regressed_px), peak


def decode_pose(outputs: Mapping[str, np.ndarray], region: Region) -> PoseOutputs:
    """Decode the outputs of one crop.

    They are ``landmarks``, 39 times x, y, z, visibility and presence in pixels of the crop, and ``heatmap`` (1, 39, 64,
    64).
    """
    regressed_px = outputs["landmarks"].reshape(_NUM_OUTPUTS, 5)[: len(LANDMARKS), :2].astype(np.float64)
    return PoseOutputs(
        region.image_from_crop(_from_center(regressed_px), CROP_PX), outputs["heatmap"][0, : len(LANDMARKS)], region
    )


def score_of_peak(peak: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """Score of landmarks from the peaks of their heatmaps, on MultiPose's scale; 0 below ``SURE_PEAK``."""
    return np.where(peak >= SURE_PEAK, peak - _SCORE_BELOW_PEAK, 0.0)


def body_region(
    keypoints_px: Float[np.ndarray, "joints 2"], score: Float[np.ndarray, " joints"], turn_deg: float = 0.0
) -> Region | None:
    """Region of a body: a circle around its joints, with hips and shoulders upright.

    A body whose trunk has no certain direction is taken as upright in the image turned counterclockwise by
    ``turn_deg``.

    Joints are ``COCO_17`` in pixels of the image, NaN where missing, with their scores. ``None`` for a body
    that is too small or has too few joints.
    """
    seen = (score >= _MIN_SCORE) & np.isfinite(keypoints_px).all(-1)
    if seen.sum() < _MIN_JOINTS or body_size_px(keypoints_px, seen) < _MIN_BODY_PX:
        return None
    hips_px, shoulders_px = (_middle(keypoints_px[pair], seen[pair]) for pair in (_HIPS, _SHOULDERS))
    box_px = np.stack([keypoints_px[seen].min(0), keypoints_px[seen].max(0)])
    center_px = box_px.mean(0) if hips_px is None else hips_px
    radius_px = _BODY_RADIUS * np.linalg.norm(keypoints_px[seen] - center_px, axis=-1).max()
    angle_rad = float(np.radians(turn_deg))
    if hips_px is not None and shoulders_px is not None:
        trunk_px = shoulders_px - hips_px
        if np.linalg.norm(trunk_px) > _MIN_TRUNK * radius_px:
            angle_rad = upward(trunk_px)
    return Region((float(center_px[0]), float(center_px[1])), float(_SIDE * radius_px), angle_rad)


def body_size_px(keypoints_px: Float[np.ndarray, "joints 2"], seen: Bool[np.ndarray, " joints"]) -> float:
    """Diagonal of the box around the joints that are seen; 0 if none is seen."""
    return float(np.linalg.norm(np.ptp(keypoints_px[seen], axis=0))) if seen.any() else 0.0


def _middle(pair_px: Float[np.ndarray, "2 2"], seen: Bool[np.ndarray, " 2"]) -> Float[np.ndarray, " 2"] | None:
    return pair_px[seen].mean(0) if seen.any() else None


def _from_center(points_px: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 2"]:
    """Positions from the centre of the crop's first pixel."""
    return points_px - 0.5


def read_near(
    logits: Float[np.ndarray, "maps height width"], expected: Float[np.ndarray, "maps 2"]
) -> tuple[Float[np.ndarray, "maps 2"], Float[np.ndarray, " maps"]]:
    """Read each heatmap around an expected position: the mean of the window's cells, weighted by their heat.

    ``logits``: heatmaps before the sigmoid. ``expected``: positions (x, y) in cells; the centre of the first cell is
    (0, 0). NaN for a position that is not known. Returns positions (x, y) in cells, NaN where the expected position is
    NaN or outside of the map; and the greatest heat in the window, in [0, 1], 0 there.
    """
    height, width = logits.shape[1:]
    known = np.asarray(((expected >= -0.5) & (expected < (width - 0.5, height - 0.5))).all(-1))
    central = np.rint(np.where(known[:, None], expected, 0.0)).astype(np.int64)
    steps = np.arange(-_REACH_CELLS, _REACH_CELLS + 1)
    columns, rows = central[:, :1] + steps, central[:, 1:] + steps
    is_inside = ((rows >= 0) & (rows < height))[:, :, None] & ((columns >= 0) & (columns < width))[:, None, :]
    maps = np.arange(len(logits))[:, None, None]
    window = logits[maps, rows.clip(0, height - 1)[:, :, None], columns.clip(0, width - 1)[:, None, :]]
    heat = np.where(is_inside & known[:, None, None], _sigmoid(window.astype(np.float64)), 0.0)
    total = heat.sum((1, 2))
    weight = np.where(known, total, np.nan)
    position = np.stack([(heat.sum(1) * columns).sum(1), (heat.sum(2) * rows).sum(1)], axis=-1) / weight[:, None]
    return position, heat.max((1, 2))


def _sigmoid(logits: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    return 1 / (1 + np.exp(-logits.clip(-60, 60)))
