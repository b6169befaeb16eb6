"""Convert a frozen TensorFlow graph of convolutions to ONNX, without TensorFlow.

Activations change from NHWC to NCHW, weights likewise; a bias that is added to a convolution becomes its own.
"""

from collections.abc import Callable, Mapping

import numpy as np

from pipeline.detect.conversion.onnx_graph import OnnxGraph
from pipeline.detect.conversion.tf_graph import Node, read_graph
from pipeline.errors import ModelError

_CHANNELS_LAST = frozenset({3, -1})


def convert(content: bytes, input_name: str, source: str, outputs: Mapping[str, int]) -> bytes:
    """Convert what lies between the graph's placeholder and one of its nodes.

    Parameters
    ----------
    content
        A serialised ``GraphDef`` whose variables are constants.
    input_name
        What the image, of three channels, is called in ONNX.
    source, outputs
        The node whose channels are split into the outputs, and these with their numbers of channels.

    Returns
    -------
        The ONNX model, float32, NCHW; the same bytes for the same arguments.

    Raises
    ------
    ModelError
        If the graph is damaged, lacks a node, or needs an operation that is not supported.
    """
    conversion = _Conversion(read_graph(content), input_name)
    conversion.onnx.emit_split(conversion.activation(source), dict(outputs))
    return conversion.onnx.encode({input_name: 3}, dict(outputs))


class _Conversion:
    """Nodes are converted when something asks for what they make."""

    def __init__(self, nodes: Mapping[str, Node], input_name: str) -> None:
        self.onnx = OnnxGraph()
        self._nodes = nodes
        self._input_name = input_name
        self._made: dict[str, str] = {}

    def activation(self, name: str) -> str:
        """ONNX name of what a node makes."""
        if name not in self._made:
            node = self.node(name)
            handler = _HANDLERS.get(node.kind)
            if handler is None:
                raise ModelError(f"The TensorFlow graph needs {node.kind}, which is not supported.")
            self._made[name] = self._input_name if node.kind == "Placeholder" else handler(self, node)
        return self._made[name]

    def node(self, name: str) -> Node:
        """A node by its name."""
        if name not in self._nodes:
            raise ModelError(f"The TensorFlow graph has no node {name}: it is not the version that is needed.")
        return self._nodes[name]

    def constant(self, name: str) -> np.ndarray:
        """Value of a constant."""
        value = self.node(name).value
        if value is None:
            raise ModelError(f"The TensorFlow graph is not frozen: {name} is no constant.")
        return value


def _convolution(conversion: _Conversion, node: Node, bias: str | None = None) -> str:
    """Weights: height, width, input channels, then output channels or, depthwise, a multiplier of 1."""
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
        raise ModelError("The TensorFlow graph adds a bias to what is no convolution, which is not supported.")
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
