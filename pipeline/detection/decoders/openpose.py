"""Decoder of networks of OpenPose's kind: order of the channels, and maps to peaks and fields."""

from collections.abc import Mapping

import numpy as np

from pipeline.core.data.detections import MapGrid
from pipeline.core.joints import COCO_18
from pipeline.detection.decoders.fields import ImageFields, read_fields

# First and second joint of each limb, and the channel of its x component; y is the next channel (OpenPose's COCO
# model). Limbs are ordered from the neck on, as ``grouping.group`` needs.
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
"""First and second joint of each field's limb, as numbers of ``COCO_18``."""
_CHANNELS = np.array([[channel, channel + 1] for _, _, channel in _LIMBS])


def decode_openpose(outputs: Mapping[str, np.ndarray], grid: MapGrid, image_size_px: tuple[int, int]) -> ImageFields:
    """Decode a network's outputs to peaks in pixels of the image and fields.

    They are ``heatmaps`` (1, 19, height, width), whose last channel is the background, and ``pafs`` (1, 38, height,
    width). ``grid`` has the positions of their cells on the image.
    """
    heatmaps = outputs["heatmaps"][0, : len(COCO_18.names)]
    return read_fields(heatmaps, outputs["pafs"][0], grid, image_size_px, _CHANNELS)
