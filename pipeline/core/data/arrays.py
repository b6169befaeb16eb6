"""Read-only arrays, and empty ones for the records' defaults."""

import numpy as np
from jaxtyping import Float, Int, UInt8


def read_only(array: np.ndarray) -> np.ndarray:
    """Mark an array as read-only and return it."""
    array.flags.writeable = False
    return array


def no_frames() -> Int[np.ndarray, " 0"]:
    """Return an empty, read-only array of frame numbers."""
    return read_only(np.empty(0, np.int64))


def no_changes() -> Float[np.ndarray, " 0"]:
    """Return an empty, read-only array of changes of pictures."""
    return read_only(np.empty(0, np.float32))


def no_samples() -> UInt8[np.ndarray, " 0"]:
    """Return an empty, read-only array of samples of a picture."""
    return read_only(np.empty(0, np.uint8))


def no_colours() -> UInt8[np.ndarray, "0 0 0"]:
    """Return an empty, read-only array of colour histograms: colours were not measured."""
    return read_only(np.empty((0, 0, 0), np.uint8))


def no_detections() -> Int[np.ndarray, "0 0"]:
    """Return an empty, read-only array of detections by frame and camera."""
    return read_only(np.empty((0, 0), np.int32))
