"""Networks: ONNX models on the execution provider of this process."""

import logging
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float32

from pipeline.core.errors import ModelError
from pipeline.core.options.providers import ProviderName
from pipeline.detection.providers.find import current_provider
from pipeline.detection.providers.open import open_session

_LOG = logging.getLogger(__name__)

# Function from a batch of images to named outputs.
Network = Callable[[Float32[np.ndarray, "batch 3 height width"]], Mapping[str, np.ndarray]]


@dataclass(slots=True)
class NetworkClock:
    """Clock of the time that this process has spent in networks."""

    total_s: float = 0.0  # Seconds in all networks so far
    core_s: float = 0.0  # Seconds of a core in them, which other programs do not lengthen
    num_passes: int = 0  # Number of passes so far
    _turn: threading.Lock = field(default_factory=threading.Lock, repr=False)  # Held during a pass

    @contextmanager
    def running(self) -> Iterator[None]:
        """Count the time of a block as one pass of a network; other threads wait with their passes."""
        with self._turn:
            started_s, core_started_s = time.perf_counter(), time.thread_time()
            yield
            self.total_s += time.perf_counter() - started_s
            self.core_s += time.thread_time() - core_started_s
            self.num_passes += 1


NETWORK_CLOCK = NetworkClock()
"""Clock of this process; benchmarks read it."""


def open_network(path: Path) -> Network:
    """Open an ONNX model with one input on the provider of this process, see ``providers.find.current_provider``.

    Images are run one by one on the CPU, where a batch gains nothing and results do not depend on what it holds; other
    providers run a batch at once. A network runs on the CPU all the same, with a warning in the log, if the provider
    can't run it or its outputs differ from the CPU's, see ``providers.agreement``.

    Raises ``ModelError`` if the file is not an ONNX model that can be run, and ``PipelineError`` if the environment
    names no provider.
    """
    on_cpu = _open(path, "cpu")
    provider = current_provider().name
    if provider == "cpu":
        return one_by_one(on_cpu.run)
    try:
        network = _open(path, provider)
        difference = differs_by(network.run, on_cpu.run, network.input_shape)
    except ModelError as error:
        reason = str(error.__cause__)
    else:
        if difference <= MAX_DIFFERENCE:
            return network.run if network.takes_batches else one_by_one(network.run)
        reason = f"its outputs differ from the CPU's by {difference:.2g} of their largest value"
    _LOG.warning("The network %s runs on the CPU, not by %s: %s.", path.stem, provider, reason)
    return one_by_one(on_cpu.run)


def one_by_one(run: Network) -> Network:
    """Network that runs the images of a batch one after another."""

    def run_each(tensor: Float32[np.ndarray, "batch 3 height width"]) -> Mapping[str, np.ndarray]:
        if len(tensor) == 1:
            return run(tensor)
        outputs = [run(image[None]) for image in tensor]
        return {name: np.concatenate([output[name] for output in outputs]) for name in outputs[0]}

    return run_each


@dataclass(frozen=True, slots=True)
class _Opened:
    """An opened model."""

    run: Network
    input_shape: tuple[object, ...]

    @property
    def takes_batches(self) -> bool:
        """True if the number of images is not fixed."""
        return not isinstance(self.input_shape[0], int)


def _open(path: Path, provider: ProviderName) -> _Opened:
    try:
        session = open_session(path, provider)
        (network_input,) = session.get_inputs()
    except Exception as error:  # ONNX Runtime's errors have no common base
        raise ModelError(f"{path.name} is damaged or can't be run; install it again.") from error
    output_names = [output.name for output in session.get_outputs()]

    def run(tensor: Float32[np.ndarray, "batch 3 height width"]) -> dict[str, np.ndarray]:
        with NETWORK_CLOCK.running():
            return dict(zip(output_names, session.run(output_names, {network_input.name: tensor}), strict=True))

    return _Opened(run, tuple(network_input.shape))


# Agreement of an execution provider with the CPU: both run a network on noise. A network computes the same function of
# every picture, so that any picture shows another precision: on noise of four sizes the largest differences are 0.00006
# of an output's largest value in single precision, 0.02 in half precision and 0.2 in bfloat16
# (docs/lab/operations-notes.md).
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
