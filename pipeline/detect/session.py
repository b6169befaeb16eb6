"""ONNX Runtime sessions on a single CPU thread, with reproducible outputs."""

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import onnxruntime
from jaxtyping import Float32

from pipeline.errors import ModelError

# Function from an image tensor to named outputs.
Network = Callable[[Float32[np.ndarray, "1 3 height width"]], Mapping[str, np.ndarray]]


@dataclass(slots=True)
class NetworkClock:
    """Clock of the time that this process has spent in networks."""

    total_s: float = 0.0  # Seconds in all networks so far
    num_passes: int = 0  # Number of passes so far

    @contextmanager
    def running(self) -> Iterator[None]:
        """Count the time of a block as one pass of a network."""
        started_s = time.perf_counter()
        yield
        self.total_s += time.perf_counter() - started_s
        self.num_passes += 1


NETWORK_CLOCK = NetworkClock()
"""Clock of this process; benchmarks read it."""


def open_network(path: Path) -> Network:
    """Open an ONNX model with one input.

    Each process uses one thread: several processes use the CPU better than several threads of a process, and results
    do not depend on the split of the work. Raises ``ModelError`` if the file is not an ONNX model that can be run.
    """
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
    options.use_deterministic_compute = True
    options.log_severity_level = 3
    try:
        session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
        (network_input,) = session.get_inputs()
    except Exception as error:  # ONNX Runtime's errors have no common base
        raise ModelError(f"{path.name} is damaged or can't be run; install it again.") from error
    output_names = [output.name for output in session.get_outputs()]

    def run(tensor: Float32[np.ndarray, "1 3 height width"]) -> dict[str, np.ndarray]:
        with NETWORK_CLOCK.running():
            return dict(zip(output_names, session.run(output_names, {network_input.name: tensor}), strict=True))

    return run
