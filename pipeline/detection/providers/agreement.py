"""Agreement of an execution provider with the CPU: both run a network on noise.

A network computes the same function of every picture, so that any picture shows another precision: on noise of four
sizes the largest differences are 0.00006 of an output's largest value in single precision, 0.02 in half precision and
0.2 in bfloat16 (docs/lab/operations-notes.md).
"""

from collections.abc import Callable, Mapping, Sequence

import cv2
import numpy as np
from jaxtyping import Float32

MAX_DIFFERENCE = 1e-3
"""Largest difference between an output and the CPU's, as a share of the output's largest value.

A thousandth of the side of a crop of 256 pixels is a quarter of a pixel.
"""
_SIZES_PX = (4, 16, 64)
_USUAL_PX = 256

Outputs = Mapping[str, np.ndarray]


def differs_by(
    run: Callable[[Float32[np.ndarray, "1 3 height width"]], Outputs],
    run_on_cpu: Callable[[Float32[np.ndarray, "1 3 height width"]], Outputs],
    input_shape: Sequence[object],
) -> float:
    """Largest difference of the outputs for noise, as a share of the largest value of each output on the CPU.

    ``input_shape`` is the network's, (1, 3, height, width), with names for sizes that are not fixed. A value that is
    not finite on one side alone differs infinitely.
    """
    height, width = (size if isinstance(size, int) else _USUAL_PX for size in input_shape[2:])
    largest = 0.0
    for scale in (1.0, 255.0):  # networks take values of either range
        picture = noise((height, width)) * np.float32(scale)
        outputs, expected = run(picture), run_on_cpu(picture)
        for name, values in expected.items():
            largest = max(largest, _difference(outputs[name], values))
    return largest


def _difference(values: np.ndarray, expected: np.ndarray) -> float:
    if values.shape != expected.shape or (np.isfinite(values) != np.isfinite(expected)).any():
        return float("inf")
    known = np.isfinite(expected)
    if not known.any():
        return 0.0
    scale = float(np.abs(expected[known]).max())
    return float(np.abs(values[known] - expected[known]).max()) / (scale or 1.0)


def noise(size: tuple[int, int], seed: int = 0) -> Float32[np.ndarray, "1 3 height width"]:
    """Picture of coloured noise with patches of several sizes, in [0, 1]; ``size`` is height and width."""
    random, (height, width) = np.random.default_rng(seed), size
    layers = [
        cv2.resize(
            random.random((height // patch_px + 2, width // patch_px + 2, 3), np.float32),
            (width, height),
            interpolation=cv2.INTER_CUBIC,
        )
        for patch_px in _SIZES_PX
    ]
    weights = np.array(_SIZES_PX, np.float32) / sum(_SIZES_PX)
    mixed = np.einsum("l,lhwc->chw", weights, np.stack(layers)).clip(0.0, 1.0)
    return np.ascontiguousarray(mixed[None], np.float32)
