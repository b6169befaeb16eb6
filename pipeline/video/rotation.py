"""Pictures mirrored and turned by quarters. It loads OpenCV, which the child processes that probe do without."""

import cv2
import numpy as np
from jaxtyping import UInt8

_CODES = {1: cv2.ROTATE_90_COUNTERCLOCKWISE, 2: cv2.ROTATE_180, 3: cv2.ROTATE_90_CLOCKWISE}


class Rotator:
    """Turns pictures of one camera for display; a turned picture is valid until the next one is turned."""

    def __init__(self) -> None:
        self._turned = np.empty((0, 0, 3), np.uint8)

    def __call__(
        self, image: UInt8[np.ndarray, "height width 3"], quarters: int, is_mirrored: bool = False
    ) -> UInt8[np.ndarray, "turned_height turned_width 3"]:
        """Exchange left and right of a picture if it is mirrored, then turn it counterclockwise.

        A picture that is neither mirrored nor turned is returned itself.
        """
        if is_mirrored:
            image = cv2.flip(image, 1)
        quarters %= 4
        if quarters == 0:
            return image
        height, width = image.shape[:2]
        shape = (height, width, 3) if quarters == 2 else (width, height, 3)
        if self._turned.shape != shape:
            self._turned = np.empty(shape, np.uint8)
        return cv2.rotate(image, _CODES[quarters], dst=self._turned)
