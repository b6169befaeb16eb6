"""Conversion of a float TensorFlow Lite model, or a part of it, to ONNX, without TensorFlow.

Activations change from NHWC to NCHW, weights from half to single precision, which is exact. Only the part between the
chosen inputs and outputs is converted: the model's own decoding is left out.
"""

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import tflite
from jaxtyping import Int

from pipeline.core.errors import ModelError
from pipeline.detection.conversion.onnx_graph import Axes, OnDemandConversion

_DTYPES = {
    tflite.TensorType.FLOAT32: np.float32,
    tflite.TensorType.FLOAT16: np.float16,
    tflite.TensorType.INT32: np.int32,
}
_OPERATOR_KINDS = {code: kind for kind, code in vars(tflite.BuiltinOperator).items() if isinstance(code, int)}
_OPTION_KINDS = {code: kind for kind, code in vars(tflite.BuiltinOptions).items() if isinstance(code, int) and code}


@dataclass(frozen=True, slots=True, eq=False)
class Tensor:
    """Tensor of a model: name, shape (NHWC, 1 for an open axis), and value if it is a constant of a known type."""

    name: str
    shape: tuple[int, ...]
    value: np.ndarray | None


@dataclass(frozen=True, slots=True)
class Operator:
    """Operator of a model."""

    kind: str  # Name of the operation, such as ``CONV_2D``
    # Indices of tensors; -1 for an omitted input
    inputs: tuple[int, ...]
    outputs: tuple[int, ...]
    # Table of the schema with the operation's options, such as ``tflite.Conv2DOptions``; ``None`` without options
    options: Any


@dataclass(frozen=True)
class Graph:
    """Main graph of a model; operators refer to tensors by index."""

    tensors: tuple[Tensor, ...]
    operators: tuple[Operator, ...]

    @cached_property
    def producers(self) -> dict[int, Operator]:
        """Operator that computes a tensor, by the tensor's index."""
        return {index: operator for operator in self.operators for index in operator.outputs}

    @cached_property
    def activations(self) -> dict[str, int]:
        """Tensors that depend on the input, by name up to the first semicolon (fused operators follow it)."""
        variable = [index for index in range(len(self.tensors)) if self.constant(index) is None]
        return {self.tensors[index].name.partition(";")[0]: index for index in variable}

    def constant(self, index: int) -> np.ndarray | None:
        """Value of a constant, half precision converted to single; ``None`` for tensors that depend on the input."""
        value = self.tensors[index].value
        if value is not None:
            return value.astype(np.float32) if value.dtype == np.float16 else value
        producer = self.producers.get(index)
        return self.constant(producer.inputs[0]) if producer and producer.kind == "DEQUANTIZE" else None


def read_model(model: bytes) -> Graph:
    """Read a TensorFlow Lite flatbuffer. Raises ``ModelError`` if the content is damaged or is not such a model."""
    try:
        root = tflite.Model.GetRootAs(model)
        graph = root.Subgraphs(0)
        return Graph(
            tuple(_tensor(root, graph.Tensors(k)) for k in range(graph.TensorsLength())),
            tuple(_operator(root, graph.Operators(k)) for k in range(graph.OperatorsLength())),
        )
    except (struct.error, IndexError, ValueError, TypeError, AttributeError, KeyError) as error:
        raise ModelError("The TensorFlow Lite model is damaged or has another format.") from error


def _tensor(root: tflite.Model, tensor: tflite.Tensor) -> Tensor:
    shape = tuple(tensor.ShapeAsNumpy().tolist()) if tensor.ShapeLength() else ()
    buffer = root.Buffers(tensor.Buffer())
    dtype = _DTYPES.get(tensor.Type())
    known = dtype is not None and buffer.DataLength() > 0
    value = np.frombuffer(buffer.DataAsNumpy(), dtype).reshape(shape) if known else None
    return Tensor(tensor.Name().decode(), shape, value)


def _operator(root: tflite.Model, operator: tflite.Operator) -> Operator:
    code = root.OperatorCodes(operator.OpcodeIndex())
    # Codes below 127 are in the deprecated field, which is saturated for other codes.
    kind = _OPERATOR_KINDS[max(code.BuiltinCode(), code.DeprecatedBuiltinCode())]
    return Operator(
        kind,
        tuple(operator.InputsAsNumpy().tolist()) if operator.InputsLength() else (),
        tuple(operator.OutputsAsNumpy().tolist()) if operator.OutputsLength() else (),
        _options(operator),
    )


def _options(operator: tflite.Operator) -> Any:
    kind = _OPTION_KINDS.get(operator.BuiltinOptionsType())
    if kind is None:
        return None
    table = operator.BuiltinOptions()
    options = getattr(tflite, kind)()
    options.Init(table.Bytes, table.Pos)
    return options


NCHW_FROM_NHWC = (0, 3, 1, 2)


class TfliteConversion(OnDemandConversion[int]):
    """Conversion of operators, by the index of their output.

    ``starts`` are the names in ONNX of the inputs, by index; ``handlers`` convert an operator, by its kind.
    """

    def __init__(self, graph: Graph, starts: dict[int, str], handlers: Mapping[str, "Handler"]) -> None:
        super().__init__(starts)
        self.graph = graph
        self.starts = starts
        self._handlers = handlers

    def convert(self, index: int) -> str:
        """Convert the operator that computes a tensor."""
        operator = self.graph.producers.get(index)
        handler = self._handlers.get(operator.kind) if operator else None
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
        return self.onnx.add_constant(f"t{index}", four_axes.transpose(NCHW_FROM_NHWC))

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


Handler = Callable[[TfliteConversion, Operator, str], str]
"""Function that converts an operator under a name for its output; returns the output's name in ONNX."""


def _convolution(conversion: TfliteConversion, operator: Operator, name: str) -> str:
    """Convert a convolution; weights are (output channels, height, width, input channels)."""
    weights = conversion.weights(operator.inputs[1]).transpose(NCHW_FROM_NHWC)
    return _emit_convolution(conversion, operator, name, weights, num_groups=1)


def _depthwise_convolution(conversion: TfliteConversion, operator: Operator, name: str) -> str:
    """Convert a depthwise convolution; weights are (1, height, width, channels)."""
    if operator.options.DepthMultiplier() != 1:
        raise ModelError("The TensorFlow Lite model needs a depth multiplier, which is not supported.")
    weights = conversion.weights(operator.inputs[1]).transpose(3, 0, 1, 2)
    return _emit_convolution(conversion, operator, name, weights, num_groups=len(weights))


def _emit_convolution(
    conversion: TfliteConversion, operator: Operator, name: str, weights: np.ndarray, num_groups: int
) -> str:
    options = operator.options
    if (options.DilationHFactor(), options.DilationWFactor()) != (1, 1):
        raise ModelError("The TensorFlow Lite model needs a dilated convolution, which is not supported.")
    source, padding = _source_and_padding(conversion, operator)
    inputs = [source, conversion.onnx.add_constant(f"{name}_weights", weights), *_bias(conversion, operator, name)]
    conversion.onnx.emit(
        "Conv",
        inputs,
        name,
        group=num_groups,
        kernel_shape=list(weights.shape[2:]),
        strides=[options.StrideH(), options.StrideW()],
        dilations=[1, 1],
        **padding,
    )
    return conversion.activate(name, options.FusedActivationFunction())


def _source_and_padding(conversion: TfliteConversion, operator: Operator) -> tuple[str, dict[str, Any]]:
    """Input of a convolution and attributes of its padding; a padding operator before it is merged into it.

    A padding of its own would cost a fifth of the time of BlazePose.
    """
    source, auto_pad = operator.inputs[0], _padding(operator.options)
    before = conversion.graph.producers.get(source)
    if before is not None and before.kind == "PAD" and auto_pad == "VALID":
        _, channels, *rows_and_columns = _pads(conversion, before)
        if not channels.any():
            pads = np.transpose(rows_and_columns).reshape(-1).tolist()
            return conversion.activation(before.inputs[0]), {"pads": pads}
    return conversion.activation(source), {"auto_pad": auto_pad}


def _pads(conversion: TfliteConversion, padding: Operator) -> Int[np.ndarray, "4 2"]:
    """Numbers of zeros before and after each axis of a padded tensor, in ONNX's order of the axes."""
    return conversion.weights(padding.inputs[1])[list(NCHW_FROM_NHWC)].astype(np.int64)


def _elementwise(kind: str) -> Handler:
    def handle(conversion: TfliteConversion, operator: Operator, name: str) -> str:
        conversion.onnx.emit(kind, [conversion.operand(index) for index in operator.inputs], name)
        return conversion.activate(name, operator.options.FusedActivationFunction())

    return handle


def _sigmoid(conversion: TfliteConversion, operator: Operator, name: str) -> str:
    return conversion.onnx.emit("Sigmoid", [conversion.activation(operator.inputs[0])], name)


def _resize_bilinear(conversion: TfliteConversion, operator: Operator, name: str) -> str:
    """Convert a resizing to a constant size, or by a constant factor: the new size is the old size times a constant."""
    factors = _resize_factors(conversion, operator)
    if factors is None or not operator.options.HalfPixelCenters():
        raise ModelError("The TensorFlow Lite model resizes in a way that is not supported.")
    scales = conversion.onnx.add_constant(f"{name}_scales", np.array([1, 1, *factors], np.float32))
    source = conversion.activation(operator.inputs[0])
    return conversion.onnx.emit(
        "Resize", [source, "", scales], name, mode="linear", coordinate_transformation_mode="half_pixel"
    )


def _resize_factors(conversion: TfliteConversion, operator: Operator) -> np.ndarray | None:
    """Factors of height and width; ``None`` if they are not constant."""
    graph = conversion.graph
    size = graph.constant(operator.inputs[1])
    if size is not None:
        return size / graph.tensors[operator.inputs[0]].shape[1:3]
    new_size = graph.producers.get(operator.inputs[1])
    return graph.constant(new_size.inputs[1]) if new_size and new_size.kind == "MUL" else None


def _pad(conversion: TfliteConversion, operator: Operator, name: str) -> str:
    """Convert a padding with zeros, of rows, columns or channels."""
    pads = conversion.onnx.add_constant(f"{name}_pads", _pads(conversion, operator).T.reshape(-1))
    return conversion.onnx.emit("Pad", [conversion.activation(operator.inputs[0]), pads], name, mode="constant")


def _max_pool(conversion: TfliteConversion, operator: Operator, name: str) -> str:
    options = operator.options
    conversion.onnx.emit(
        "MaxPool",
        [conversion.activation(operator.inputs[0])],
        name,
        kernel_shape=[options.FilterHeight(), options.FilterWidth()],
        strides=[options.StrideH(), options.StrideW()],
        auto_pad=_padding(options),
    )
    return conversion.activate(name, options.FusedActivationFunction())


def _mean(conversion: TfliteConversion, operator: Operator, name: str) -> str:
    """Convert a mean over rows and columns."""
    if sorted(conversion.weights(operator.inputs[1]).tolist()) != [1, 2]:
        raise ModelError("The TensorFlow Lite model averages other axes than rows and columns, which is not supported.")
    source = conversion.activation(operator.inputs[0])
    return conversion.onnx.emit("ReduceMean", [source], name, axes=[2, 3], keepdims=int(operator.options.KeepDims()))


def _fully_connected(conversion: TfliteConversion, operator: Operator, name: str) -> str:
    """Convert a product with a matrix of weights (outputs, inputs); the input has two axes."""
    if len(conversion.graph.tensors[operator.inputs[0]].shape) != 2:
        raise ModelError("The TensorFlow Lite model multiplies maps with a matrix, which is not supported.")
    weights = conversion.onnx.add_constant(f"{name}_weights", conversion.weights(operator.inputs[1]))
    inputs = [conversion.activation(operator.inputs[0]), weights, *_bias(conversion, operator, name)]
    conversion.onnx.emit("Gemm", inputs, name, transB=1)
    return conversion.activate(name, operator.options.FusedActivationFunction())


def _reshape(conversion: TfliteConversion, operator: Operator, name: str) -> str:
    """Convert a change of a map to other axes; the first axis, of the batch, stays."""
    source, shape = (conversion.graph.tensors[index].shape for index in (operator.inputs[0], operator.outputs[0]))
    if len(source) != 4 or len(shape) == 4 or source[0] != shape[0]:
        raise ModelError("The TensorFlow Lite model reshapes in a way that is not supported.")
    channels_last = conversion.onnx.emit(
        "Transpose", [conversion.activation(operator.inputs[0])], f"{name}_nhwc", perm=[0, 2, 3, 1]
    )
    # 0 copies the size of the source's axis.
    new_shape = conversion.onnx.add_constant(f"{name}_shape", np.array([0, *shape[1:]], np.int64))
    return conversion.onnx.emit("Reshape", [channels_last, new_shape], name)


def _bias(conversion: TfliteConversion, operator: Operator, name: str) -> list[str]:
    """ONNX name of an operator's bias; empty without a bias."""
    if len(operator.inputs) < 3 or operator.inputs[2] < 0:
        return []
    return [conversion.onnx.add_constant(f"{name}_bias", conversion.weights(operator.inputs[2]))]


def _padding(options: Any) -> str:
    # TensorFlow's SAME pads the odd pixel at the end.
    return "SAME_UPPER" if options.Padding() == tflite.Padding.SAME else "VALID"


HANDLERS: Mapping[str, Handler] = {
    "CONV_2D": _convolution,
    "DEPTHWISE_CONV_2D": _depthwise_convolution,
    "ADD": _elementwise("Add"),
    "SUB": _elementwise("Sub"),
    "MUL": _elementwise("Mul"),
    "LOGISTIC": _sigmoid,
    "RESIZE_BILINEAR": _resize_bilinear,
    "PAD": _pad,
    "MAX_POOL_2D": _max_pool,
    "MEAN": _mean,
    "FULLY_CONNECTED": _fully_connected,
    "RESHAPE": _reshape,
}


def convert(model: bytes, inputs: Mapping[str, str], outputs: Mapping[str, str], is_fixed: bool = False) -> bytes:
    """Convert the part of a model between some of its tensors to a serialised ONNX model, float32 and NCHW.

    ``model``: TensorFlow Lite flatbuffer. ``inputs``, ``outputs``: names in ONNX by names in TensorFlow Lite, up to the
    first semicolon. ``is_fixed``: whether height and width are the model's; otherwise they are open. Raises
    ``ModelError`` if the model is damaged, lacks a tensor, or has an operator that is not supported.
    """
    return convert_graph(read_model(model), inputs, outputs, is_fixed)


def convert_graph(graph: Graph, inputs: Mapping[str, str], outputs: Mapping[str, str], is_fixed: bool = False) -> bytes:
    """Convert the part of a graph between some of its tensors; see ``convert``."""
    starts = {_index(graph, name): onnx_name for name, onnx_name in inputs.items()}
    conversion = TfliteConversion(graph, starts, HANDLERS)
    ends = {_index(graph, name): onnx_name for name, onnx_name in outputs.items()}
    for index, onnx_name in ends.items():
        conversion.onnx.emit("Identity", [conversion.activation(index)], onnx_name)
    return conversion.onnx.encode(
        {onnx_name: _axes(graph, index, is_fixed) for index, onnx_name in starts.items()},
        {onnx_name: _axes(graph, index, is_fixed) for index, onnx_name in ends.items()},
    )


def _index(graph: Graph, name: str) -> int:
    if name not in graph.activations:
        raise ModelError(f"The TensorFlow Lite model has no tensor {name}: it is not the version that is needed.")
    return graph.activations[name]


def _axes(graph: Graph, index: int, is_fixed: bool) -> Axes:
    shape = graph.tensors[index].shape
    if not is_fixed:
        return shape[-1]
    return tuple(shape[axis] for axis in NCHW_FROM_NHWC[1:]) if len(shape) == 4 else shape[1:]
