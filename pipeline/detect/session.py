"""ONNX Runtime on one thread of the processor: the same input gives the same output."""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import onnxruntime
from jaxtyping import Float32

from pipeline.errors import ModelError

# An image in, named outputs back.
Network = Callable[[Float32[np.ndarray, "1 3 height width"]], Mapping[str, np.ndarray]]


def open_network(path: Path) -> Network:
    """Open an ONNX file with one input.

    One thread a process: several processes use a processor better than several threads of one, and results don't depend
    on how work was split.

    Raises
    ------
    ModelError
        If the file is not an ONNX model that can be run.
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
    except Exception as error:  # ONNX Runtime's errors have no base of their own
        raise ModelError(f"{path.name} is damaged, or is no network that can be run; install it again.") from error
    output_names = [output.name for output in session.get_outputs()]

    def run(tensor: Float32[np.ndarray, "1 3 height width"]) -> dict[str, np.ndarray]:
        return dict(zip(output_names, session.run(output_names, {network_input.name: tensor}), strict=True))

    return run
