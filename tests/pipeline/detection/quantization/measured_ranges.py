"""Calibration: ranges of a network's intermediate values on pictures."""

import math
from collections.abc import Iterable

import numpy as np
import onnx
import onnxruntime
from jaxtyping import Float32
from onnx import TensorProto, helper

from pipeline.detection.quantization.static_quantization import STEPS_PER_OCTAVE, Steps


def measure_ranges(
    content: bytes, images: Iterable[Float32[np.ndarray, "1 channels height width"]]
) -> dict[str, Steps]:
    """Measure the ranges of all values of a network.

    Parameters
    ----------
    content
        ONNX file of a float network with one input.
    images
        Inputs of the network.

    Returns
    -------
        Least and greatest value over all images by the name of the value, rounded outwards to steps.
    """
    model = onnx.load_model_from_string(content)
    source = model.graph.input[0].name
    known = {output.name for output in model.graph.output}
    names = [name for node in model.graph.node for name in node.output]
    model.graph.output.extend(
        helper.make_tensor_value_info(name, TensorProto.FLOAT, None) for name in names if name not in known
    )
    options = onnxruntime.SessionOptions()
    # Optimizations would fuse nodes, whose values are wanted.
    options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_DISABLE_ALL
    session = onnxruntime.InferenceSession(model.SerializeToString(), options, providers=["CPUExecutionProvider"])
    low, high = dict.fromkeys([source, *names], 0.0), dict.fromkeys([source, *names], 0.0)
    for image in images:
        for name, value in zip([source, *names], [image, *session.run(names, {source: image})], strict=True):
            low[name], high[name] = min(low[name], float(value.min())), max(high[name], float(value.max()))
    return {name: (_steps(-low[name]), _steps(high[name])) for name in low}


def _steps(value: float) -> int | None:
    """Least number of steps whose end is not below a value of at least 0; ``None`` for 0."""
    return math.ceil(STEPS_PER_OCTAVE * math.log2(value)) if value > 0 else None
