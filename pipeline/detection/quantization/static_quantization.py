"""Static quantization of a network: activations as unsigned integers of 8 bits, weights as signed ones of 7 bits.

Each output channel has a scale of its weights. Sums of two products of eight-bit weights saturate on processors without
VNNI instructions, and the network's outputs become useless. Products of unsigned weights do not, but are slow on
processors with these instructions (ADR 17).
"""

import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np
import onnx
from onnx import ModelProto

_OPERATORS = ["Conv", "Add", "Resize", "Relu", "Clip"]

STEPS_PER_OCTAVE = 16
"""Ends of ranges are powers of two to multiples of 1/16."""

Steps = tuple[int | None, int | None]
"""Least and greatest value as powers of two, in steps: -2^(first / 16) and 2^(second / 16); ``None`` for zero."""


def quantize(content: bytes, ranges: Mapping[str, Steps]) -> bytes:
    """Quantize a network.

    ``content``: ONNX file of the float network, with one output a node. ``ranges``: ranges of the network's input and
    of the values that nodes give, by the name of the value. Nodes whose values have no range stay in floating point.
    Returns ONNX file of the quantized network, with the same input and outputs. Equal arguments give equal bytes.
    """
    # Imported here, as its import takes a second and is needed for an installation only.
    from onnxruntime.quantization import QuantType  # noqa: PLC0415
    from onnxruntime.quantization.calibrate import CalibrationMethod, TensorsData  # noqa: PLC0415
    from onnxruntime.quantization.qdq_quantizer import QDQQuantizer  # noqa: PLC0415

    model = onnx.load_model_from_string(content)
    for number, node in enumerate(model.graph.node):
        node.name = f"{node.op_type}_{number}"
    limits = {name: (np.float32(-end(low)), np.float32(end(high))) for name, (low, high) in ranges.items()}
    quantizer: Any = QDQQuantizer(
        model,
        per_channel=True,
        reduce_range=True,
        weight_qType=QuantType.QInt8,
        activation_qType=QuantType.QUInt8,
        tensors_range=TensorsData(CalibrationMethod.MinMax, limits),
        nodes_to_quantize=[],
        nodes_to_exclude=[node.name for node in model.graph.node if node.output[0] not in ranges],
        op_types_to_quantize=_OPERATORS,
        extra_options={"ActivationSymmetric": False},
    )
    with _without_advice():
        quantizer.quantize_model()
    quantized: ModelProto = quantizer.model.model
    return quantized.SerializeToString(deterministic=True)


def end(steps: int | None) -> float:
    """End of a range from its number of steps; 0 for ``None``."""
    return 0.0 if steps is None else float(2.0 ** (steps / STEPS_PER_OCTAVE))


@contextmanager
def _without_advice() -> Iterator[None]:
    """Silence the advice that ONNX Runtime logs for users of its own tools."""
    root = logging.getLogger()
    level = root.level
    root.setLevel(logging.ERROR)
    try:
        yield
    finally:
        root.setLevel(level)
