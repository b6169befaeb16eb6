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


# Ranges of MoveNet MultiPose's values on 40 pictures of the sample capture, in steps of `quantize`. `measure_ranges` of
# the tests measured them, on five frames of each camera at 512 and 416 pixels.

RANGES: Mapping[str, Steps] = {
    "image": (None, 127),
    "t196": (None, 127),
    "t197": (None, 15),
    "t198": (0, -3),
    "t199": (105, 108),
    "t199_relu6": (None, 42),
    "t200": (81, 81),
    "t200_relu6": (None, 42),
    "t201": (82, 76),
    "t202": (108, 108),
    "t202_relu6": (None, 42),
    "t203": (66, 64),
    "t203_relu6": (None, 42),
    "t204": (47, 45),
    "t205": (66, 68),
    "t205_relu6": (None, 42),
    "t206": (69, 60),
    "t206_relu6": (None, 42),
    "t207": (54, 51),
    "t208": (64, 63),
    "t210": (80, 79),
    "t210_relu6": (None, 42),
    "t211": (79, 57),
    "t211_relu6": (None, 42),
    "t212": (27, 27),
    "t213": (76, 74),
    "t213_relu6": (None, 42),
    "t214": (66, 58),
    "t214_relu6": (None, 42),
    "t215": (28, 30),
    "t216": (33, 43),
    "t217": (67, 60),
    "t217_relu6": (None, 42),
    "t218": (68, 60),
    "t218_relu6": (None, 42),
    "t219": (30, 28),
    "t220": (43, 51),
    "t222": (70, 65),
    "t222_relu6": (None, 42),
    "t223": (48, 59),
    "t223_relu6": (None, 42),
    "t224": (53, 53),
    "t225": (73, 67),
    "t225_relu6": (None, 42),
    "t226": (86, 62),
    "t226_relu6": (None, 42),
    "t227": (35, 40),
    "t228": (56, 56),
    "t229": (65, 65),
    "t229_relu6": (None, 42),
    "t230": (60, 63),
    "t230_relu6": (None, 42),
    "t231": (42, 41),
    "t232": (61, 58),
    "t233": (64, 64),
    "t233_relu6": (None, 42),
    "t234": (59, 63),
    "t234_relu6": (None, 42),
    "t235": (52, 54),
    "t236": (67, 68),
    "t238": (58, 62),
    "t238_relu6": (None, 42),
    "t239": (51, 65),
    "t239_relu6": (None, 42),
    "t240": (66, 65),
    "t241": (60, 67),
    "t241_relu6": (None, 42),
    "t242": (71, 66),
    "t242_relu6": (None, 42),
    "t243": (63, 61),
    "t244": (74, 73),
    "t245": (62, 64),
    "t245_relu6": (None, 42),
    "t246": (65, 67),
    "t246_relu6": (None, 42),
    "t247": (72, 69),
    "t248": (85, 79),
    "t249": (63, 66),
    "t249_relu6": (None, 42),
    "t250": (74, 61),
    "t250_relu6": (None, 42),
    "t251": (58, 61),
    "t252": (59, 70),
    "t252_relu6": (None, 42),
    "t253": (86, 65),
    "t253_relu6": (None, 42),
    "t254": (57, 55),
    "t255": (69, 70),
    "t256": (60, 67),
    "t256_relu6": (None, 42),
    "t257": (75, 65),
    "t257_relu6": (None, 42),
    "t258": (64, 65),
    "t259": (79, 76),
    "t260": (59, 73),
    "t260_relu6": (None, 42),
    "t261": (60, 65),
    "t261_relu6": (None, 42),
    "t262": (59, 60),
    "t263": (68, 72),
    "t263_relu6": (None, 42),
}
"""Ranges by the name of the value. The feature pyramid and the heads, which follow, stay in floating point."""
