"""Conversion of a frozen TensorFlow graph of convolutions to ONNX, without TensorFlow.

Activations and weights change from NHWC to NCHW. A bias that is added to a convolution becomes part of it.
"""

from collections.abc import Callable, Mapping

import numpy as np

from pipeline.detect.conversion.onnx_graph import OnDemandConversion
from pipeline.detect.conversion.tf_graph import Node, read_graph
from pipeline.errors import ModelError

_CHANNELS_LAST = frozenset({3, -1})


def convert(content: bytes, input_name: str, source: str, outputs: Mapping[str, int]) -> bytes:
    """Convert the graph from its placeholder to one of its nodes to a serialised ONNX model, float32 and NCHW.

    Parameters
    ----------
    content
        Serialised ``GraphDef`` whose variables are constants.
    input_name
        Name in ONNX of the input image, which has three channels.
    source, outputs
        Node whose channels are split into the outputs, and the number of channels of each output by name.

    Raises
    ------
    ModelError
        If the graph is damaged, lacks a node, or has an operation that is not supported.
    """
    conversion = _Conversion(read_graph(content), input_name)
    conversion.onnx.emit_split(conversion.activation(source), dict(outputs))
    return conversion.onnx.encode({input_name: 3}, dict(outputs))


class _Conversion(OnDemandConversion[str]):
    """Conversion of nodes, by name."""

    def __init__(self, nodes: Mapping[str, Node], input_name: str) -> None:
        super().__init__()
        self._nodes = nodes
        self._input_name = input_name

    def convert(self, name: str) -> str:
        """Convert a node; the placeholder is the input image."""
        node = self.node(name)
        if (handler := _HANDLERS.get(node.kind)) is None:
            raise ModelError(f"The TensorFlow graph needs {node.kind}, which is not supported.")
        return self._input_name if node.kind == "Placeholder" else handler(self, node)

    def node(self, name: str) -> Node:
        """Node of a name; ``ModelError`` if there is none."""
        if name not in self._nodes:
            raise ModelError(f"The TensorFlow graph has no node {name}: it is not the version that is needed.")
        return self._nodes[name]

    def constant(self, name: str) -> np.ndarray:
        """Value of a constant node; ``ModelError`` if the node is not constant."""
        value = self.node(name).value
        if value is None:
            raise ModelError(f"The TensorFlow graph is not frozen: {name} is not a constant.")
        return value


def _convolution(conversion: _Conversion, node: Node, bias: str | None = None) -> str:
    """Convert a convolution; weights are (height, width, input channels, output channels, or 1 if depthwise)."""
    weights = conversion.constant(node.inputs[1])
    is_depthwise = node.kind == "DepthwiseConv2dNative"
    if is_depthwise and weights.shape[3] != 1:
        raise ModelError("The TensorFlow graph needs a depth multiplier, which is not supported.")
    inputs = [
        conversion.activation(node.inputs[0]),
        conversion.onnx.add_constant(
            f"{node.name}_weights", weights.transpose(2, 3, 0, 1) if is_depthwise else weights.transpose(3, 2, 0, 1)
        ),
    ]
    if bias is not None:
        inputs.append(conversion.onnx.add_constant(f"{node.name}_bias", conversion.constant(bias)))
    return conversion.onnx.emit(
        "Conv",
        inputs,
        node.name,
        group=weights.shape[2] if is_depthwise else 1,
        kernel_shape=list(weights.shape[:2]),
        strides=list(node.strides),
        auto_pad=_padding(node),
    )


def _bias(conversion: _Conversion, node: Node) -> str:
    convolution = conversion.node(node.inputs[0])
    if convolution.kind not in {"Conv2D", "DepthwiseConv2dNative"}:
        raise ModelError(f"The TensorFlow graph adds a bias to {convolution.kind}, which is not supported.")
    return _convolution(conversion, convolution, node.inputs[1])


def _relu(conversion: _Conversion, node: Node) -> str:
    return conversion.onnx.emit("Relu", [conversion.activation(node.inputs[0])], node.name)


def _max_pool(conversion: _Conversion, node: Node) -> str:
    return conversion.onnx.emit(
        "MaxPool",
        [conversion.activation(node.inputs[0])],
        node.name,
        auto_pad=_padding(node),
        kernel_shape=list(node.window),
        strides=list(node.strides),
    )


def _concatenation(conversion: _Conversion, node: Node) -> str:
    *sources, axis = node.inputs
    if int(conversion.constant(axis)) not in _CHANNELS_LAST:
        raise ModelError("The TensorFlow graph joins other axes than channels, which is not supported.")
    return conversion.onnx.emit("Concat", [conversion.activation(name) for name in sources], node.name, axis=1)


def _padding(node: Node) -> str:
    # TensorFlow's SAME pads the odd pixel at the end.
    return "SAME_UPPER" if node.padding == "SAME" else "VALID"


_Handler = Callable[[_Conversion, Node], str]
_HANDLERS: dict[str, _Handler] = {
    "Placeholder": lambda conversion, node: node.name,
    "Conv2D": _convolution,
    "DepthwiseConv2dNative": _convolution,
    "BiasAdd": _bias,
    "Relu": _relu,
    "MaxPool": _max_pool,
    "ConcatV2": _concatenation,
}
