"""The two networks of OpenPose's kind: which channel is what, and how their maps become fields."""

from collections.abc import Mapping

import numpy as np

from pipeline.data import MapGrid
from pipeline.detect.decoders.fields import ImageFields, read_fields
from pipeline.joints import COCO_18

# The joints that a limb leads from and to, and the channel of its x; y is the next one. In an order from the neck on:
# who groups limb by limb has reached the first joint before. Channels: OpenPose's COCO model.
_LIMBS = (
    ("neck", "right_shoulder", 12),
    ("neck", "left_shoulder", 20),
    ("neck", "right_hip", 0),
    ("neck", "left_hip", 6),
    ("neck", "nose", 28),
    ("right_shoulder", "right_elbow", 14),
    ("left_shoulder", "left_elbow", 22),
    ("right_elbow", "right_wrist", 16),
    ("left_elbow", "left_wrist", 24),
    ("right_hip", "right_knee", 2),
    ("left_hip", "left_knee", 8),
    ("right_knee", "right_ankle", 4),
    ("left_knee", "left_ankle", 10),
    ("nose", "right_eye", 30),
    ("nose", "left_eye", 32),
    ("right_eye", "right_ear", 34),
    ("left_eye", "left_ear", 36),
    ("right_shoulder", "right_ear", 18),
    ("left_shoulder", "left_ear", 26),
)
LIMBS = np.array([COCO_18.indices((first, second)) for first, second, _ in _LIMBS])
"""Joints of ``COCO_18`` that each field leads from and to."""
_CHANNELS = np.array([[channel, channel + 1] for _, _, channel in _LIMBS])


def decode_openpose(outputs: Mapping[str, np.ndarray], grid: MapGrid, image_size_px: tuple[int, int]) -> ImageFields:
    """Read a network's outputs ``heatmaps`` (1, 19, height, width; the last is the background) and ``pafs``."""
    heatmaps = outputs["heatmaps"][0, : len(COCO_18.names)]
    return read_fields(heatmaps, outputs["pafs"][0], grid, image_size_px, _CHANNELS)
