"""Cameras whose calibration is to be made."""

import numpy as np

from pipeline.data import Camera, read_only
from pipeline.geometry.rigid import Rigid3


def guessed_camera(name: str, size_px: tuple[int, int]) -> Camera:
    """Guess the intrinsics of a camera from the size of its picture; its pose is the identity.

    The focal length is the longer side, a horizontal field of view of 53 degrees, between those of phones and of action
    cameras without a wide lens.
    """
    width, height = size_px
    focal_px = float(max(size_px))
    matrix = [[focal_px, 0.0, (width - 1) / 2], [0.0, focal_px, (height - 1) / 2], [0.0, 0.0, 1.0]]
    pose = Rigid3(read_only(np.eye(3)), read_only(np.zeros(3)))
    return Camera(name, size_px, read_only(np.array(matrix)), read_only(np.zeros(0)), pose)
