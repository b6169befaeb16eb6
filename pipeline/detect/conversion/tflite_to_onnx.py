"""Conversion of the convolutional part of a float TensorFlow Lite model to ONNX, without TensorFlow.

Activations change from NHWC to NCHW, weights from half to single precision, which is exact; height and width are open.
Only the part between the chosen inputs and outputs is converted: the model's own decoding is left out.
Semantics of operators: the TensorFlow Lite schema, and https://onnx.ai/onnx/operators/.
"""

from collections.abc import Callable, Mapping

import numpy as np
import tflite

from pipeline.detect.conversion.onnx_graph import OnDemandConversion
from pipeline.detect.conversion.tflite_model import Graph, Operator, read_model
from pipeline.errors import ModelError

_NCHW_FROM_NHWC = (0, 3, 1, 2)


def convert(model: bytes, inputs: Mapping[str, str], outputs: Mapping[str, str]) -> bytes:
    """Convert the part of a model between some of its tensors to a serialised ONNX model, float32 and NCHW.

    Parameters
    ----------
    model
        TensorFlow Lite flatbuffer.
    inputs, outputs
        Names in ONNX by names in TensorFlow Lite, up to the first semicolon.

    Raises
    ------
    ModelError
        If the model is damaged, lacks a tensor, or has an operator that is not supported.
    """
    return convert_graph(read_model(model), inputs, outputs)


def convert_graph(graph: Graph, inputs: Mapping[str, str], outputs: Mapping[str, str]) -> bytes:
    """Convert the part of a graph between some of its tensors; see ``convert``."""
    conversion = _Conversion(graph, {_index(graph, name): onnx_name for name, onnx_name in inputs.items()})
    ends = {_index(graph, name): onnx_name for name, onnx_name in outputs.items()}
    for index, onnx_name in ends.items():
        conversion.onnx.emit("Identity", [conversion.activation(index)], onnx_name)
    return conversion.onnx.encode(
        {onnx_name: graph.tensors[index].shape[-1] for index, onnx_name in conversion.starts.items()},
        {onnx_name: graph.tensors[index].shape[-1] for index, onnx_name in ends.items()},
    )


def _index(graph: Graph, name: str) -> int:
    if name not in graph.activations:
        raise ModelError(f"The TensorFlow Lite model has no tensor {name}: it is not the version that is needed.")
    return graph.activations[name]


class _Conversion(OnDemandConversion[int]):
    """Conversion of operators, by the index of their output; ``starts`` holds the inputs' names in ONNX by index."""

    def __init__(self, graph: Graph, starts: dict[int, str]) -> None:
        super().__init__(starts)
        self.graph = graph
        self.starts = starts

    def convert(self, index: int) -> str:
        """Convert the operator that computes a tensor."""
        operator = self.graph.producers.get(index)
        handler = _HANDLERS.get(operator.kind) if operator else None
        if operator is None or handler is None:
            needed = operator.kind if operator else "a tensor that nothing makes"
            raise ModelError(f"The TensorFlow Lite model needs {needed}, which is not supported.")
        return handler(self, operator, f"t{index}")

    def weights(self, index: int) -> np.ndarray:
        """Value of a constant tensor; ``ModelError`` if the tensor is not constant."""
        value = self.graph.constant(index)
        if value is None:
            raise ModelError("The TensorFlow Lite model has weights of a kind that is not supported.")
        return value

    def operand(self, index: int) -> str:
        """ONNX name of an operand of elementwise arithmetic: a constant or an activation."""
        value = self.graph.constant(index)
        if value is None:
            return self.activation(index)
        four_axes = value.reshape((1,) * (4 - value.ndim) + value.shape)
        return self.onnx.add_constant(f"t{index}", four_axes.transpose(_NCHW_FROM_NHWC))

    def activate(self, name: str, function: int) -> str:
        """Apply the activation function that is fused into an operator; return the name of its output."""
        if function == tflite.ActivationFunctionType.NONE:
            return name
        if function == tflite.ActivationFunctionType.RELU:
            return self.onnx.emit("Relu", [name], f"{name}_relu")
        if function == tflite.ActivationFunctionType.RELU6:
            bounds = [
                self.onnx.add_constant("zero", np.array(0, np.float32)),
                self.onnx.add_constant("six", np.array(6, np.float32)),
            ]
            return self.onnx.emit("Clip", [name, *bounds], f"{name}_relu6")
        raise ModelError(f"The TensorFlow Lite model needs activation {function}, which is not supported.")


def _convolution(conversion: _Conversion, operator: Operator, name: str) -> str:
    """Convert a convolution; weights are (output channels, height, width, input channels)."""
    weights = conversion.weights(operator.inputs[1]).transpose(_NCHW_FROM_NHWC)
    return _emit_convolution(conversion, operator, name, weights, num_groups=1)


def _depthwise_convolution(conversion: _Conversion, operator: Operator, name: str) -> str:
    """Convert a depthwise convolution; weights are (1, height, width, channels)."""
    if operator.options.DepthMultiplier() != 1:
        raise ModelError("The TensorFlow Lite model needs a depth multiplier, which is not supported.")
    weights = conversion.weights(operator.inputs[1]).transpose(3, 0, 1, 2)
    return _emit_convolution(conversion, operator, name, weights, num_groups=len(weights))


def _emit_convolution(
    conversion: _Conversion, operator: Operator, name: str, weights: np.ndarray, num_groups: int
) -> str:
    options = operator.options
    if (options.DilationHFactor(), options.DilationWFactor()) != (1, 1):
        raise ModelError("The TensorFlow Lite model needs a dilated convolution, which is not supported.")
    inputs = [conversion.activation(operator.inputs[0]), conversion.onnx.add_constant(f"{name}_weights", weights)]
    if len(operator.inputs) > 2 and operator.inputs[2] >= 0:
        inputs.append(conversion.onnx.add_constant(f"{name}_bias", conversion.weights(operator.inputs[2])))
    conversion.onnx.emit(
        "Conv",
        inputs,
        name,
        group=num_groups,
        kernel_shape=list(weights.shape[2:]),
        strides=[options.StrideH(), options.StrideW()],
        dilations=[1, 1],
        # TensorFlow's SAME pads the odd pixel at the end.
        auto_pad="SAME_UPPER" if options.Padding() == tflite.Padding.SAME else "VALID",
    )
    return conversion.activate(name, options.FusedActivationFunction())


def _elementwise(kind: str) -> "_Handler":
    def handle(conversion: _Conversion, operator: Operator, name: str) -> str:
        conversion.onnx.emit(kind, [conversion.operand(index) for index in operator.inputs], name)
        return conversion.activate(name, operator.options.FusedActivationFunction())

    return handle


def _sigmoid(conversion: _Conversion, operator: Operator, name: str) -> str:
    return conversion.onnx.emit("Sigmoid", [conversion.activation(operator.inputs[0])], name)


def _resize_bilinear(conversion: _Conversion, operator: Operator, name: str) -> str:
    """Convert an upsampling by a constant factor: the new size is the old size times a constant."""
    new_size = conversion.graph.producers.get(operator.inputs[1])
    factors = conversion.graph.constant(new_size.inputs[1]) if new_size and new_size.kind == "MUL" else None
    if factors is None or not operator.options.HalfPixelCenters():
        raise ModelError("The TensorFlow Lite model resizes in a way that is not supported.")
    scales = conversion.onnx.add_constant(f"{name}_scales", np.array([1, 1, *factors], np.float32))
    source = conversion.activation(operator.inputs[0])
    return conversion.onnx.emit(
        "Resize", [source, "", scales], name, mode="linear", coordinate_transformation_mode="half_pixel"
    )


_Handler = Callable[[_Conversion, Operator, str], str]
_HANDLERS: dict[str, _Handler] = {
    "CONV_2D": _convolution,
    "DEPTHWISE_CONV_2D": _depthwise_convolution,
    "ADD": _elementwise("Add"),
    "SUB": _elementwise("Sub"),
    "MUL": _elementwise("Mul"),
    "LOGISTIC": _sigmoid,
    "RESIZE_BILINEAR": _resize_bilinear,
}
