"""Networks: ONNX models on the execution provider of this process."""

import logging
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Float32

from pipeline.core.errors import ModelError
from pipeline.core.options.providers import ProviderName
from pipeline.detection.providers.agreement import MAX_DIFFERENCE, differs_by
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
