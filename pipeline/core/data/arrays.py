"""Read-only arrays, empty ones for the records' defaults, means of known values, and short texts of records."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np
from jaxtyping import Float, Int, UInt8


def read_only(array: np.ndarray) -> np.ndarray:
    """Mark an array as read-only and return it."""
    array.flags.writeable = False
    return array


def mean_known(values: Float[np.ndarray, "*shape"], axis: int) -> Float[np.ndarray, "*rest"]:
    """Mean over an axis of the values that are not NaN; NaN without any."""
    known = np.isfinite(values)
    count = known.sum(axis)
    return np.asarray(np.where(known, values, 0.0).sum(axis) / np.where(count, count, np.nan))


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


_MAX_TEXT = 60


def short_text(record: Any) -> str:
    """Text of a record for interpreters: arrays by type and shape, sequences by their length."""
    shown = (f"{field.name}={_short(getattr(record, field.name))}" for field in fields(record) if field.repr)
    return f"{type(record).__name__}({', '.join(shown)})"


def _short(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"{value.dtype}{list(value.shape)}"
    text = "" if isinstance(value, Sequence | Mapping) and not isinstance(value, str | tuple) else repr(value)
    if 0 < len(text) <= _MAX_TEXT:
        return text
    return f"<{len(value)} entries>" if isinstance(value, Sequence | Mapping) else f"<{type(value).__name__}>"
