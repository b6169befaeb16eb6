"""Drawn rooms in which somebody walks."""

from collections.abc import Sequence

import numpy as np

from pipeline.capture.pictures.figures import measure_figures
from pipeline.capture.pictures.sample_pictures import CameraPictures


def room(seed: int, size_px: tuple[int, int] = (320, 180)) -> np.ndarray:
    """Wall with pictures, shelves and doors, all of them rectangles with sharp edges."""
    rng = np.random.default_rng(seed)
    width, height = size_px
    image = np.full((height, width, 3), 120, np.uint8)
    for _ in range(60):
        left, top = rng.integers(0, [width - 20, height - 20])
        across, down = rng.integers(8, 60, 2)
        image[top : top + down, left : left + across] = rng.integers(30, 230, 3)
    return image


def walk(seed: int, num_frames: int, size_px: tuple[int, int] = (320, 180), from_px: int = 0) -> list[np.ndarray]:
    """Pictures of a room through which somebody walks, two pixels a picture."""
    pictures = []
    for number in range(num_frames):
        image = room(seed, size_px)
        left = (from_px + 2 * number) % (size_px[0] - 30)
        image[60:150, left : left + 25] = (240, 220, 60)
        pictures.append(image)
    return pictures


def pictures_of(camera: str, images: Sequence[np.ndarray], rate_hz: float = 1.0) -> CameraPictures:
    """Figures of pictures that are taken at equal distances in time."""
    return CameraPictures(camera, np.arange(len(images)) / rate_hz, tuple(map(measure_figures, images)))
