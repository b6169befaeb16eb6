"""Conversion of a frozen TensorFlow graph of convolutions to ONNX, without TensorFlow.

Activations and weights change from NHWC to NCHW. A bias that is added to a convolution becomes part of it.

Messages and field numbers: TensorFlow's ``core/framework/{graph,node_def,attr_value,tensor}.proto``. Only the fields of
a frozen graph of convolutions are declared; protobuf skips other fields.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import DecodeError

from pipeline.core.errors import ModelError
from pipeline.detection.conversion.onnx_graph import OnDemandConversion

_CHANNELS_LAST = frozenset({3, -1})
_DTYPES = {1: np.dtype(np.float32), 3: np.dtype(np.int32)}
_Field = descriptor_pb2.FieldDescriptorProto

# Message: field: (number, type or the name of a message, whether it is repeated). A map is a list of its entries.
_SCHEMA: dict[str, dict[str, tuple[int, int | str, bool]]] = {
    "Graph": {"node": (1, "Node", True)},
    "Node": {
        "name": (1, _Field.TYPE_STRING, False),
        "op": (2, _Field.TYPE_STRING, False),
        "input": (3, _Field.TYPE_STRING, True),
        "attr": (5, "Attribute", True),
    },
    "Attribute": {"key": (1, _Field.TYPE_STRING, False), "value": (2, "Value", False)},
    "Value": {"list": (1, "List", False), "s": (2, _Field.TYPE_BYTES, False), "tensor": (8, "Tensor", False)},
    "List": {"i": (3, _Field.TYPE_INT64, True)},
    "Tensor": {
        "dtype": (1, _Field.TYPE_INT32, False),
        "shape": (2, "Shape", False),
        "content": (4, _Field.TYPE_BYTES, False),
        "floats": (5, _Field.TYPE_FLOAT, True),
        "ints": (7, _Field.TYPE_INT32, True),
    },
    "Shape": {"dim": (2, "Dim", True)},
    "Dim": {"size": (1, _Field.TYPE_INT64, False)},
}


@dataclass(frozen=True, slots=True, eq=False)
class GraphNode:
    """Node of a graph."""

    # Name and operation of the node, such as ``conv1/Relu`` and ``Relu``
    name: str
    kind: str
    inputs: tuple[str, ...]  # Names of the input nodes
    # Kind of the padding, strides (height, width) and window (height, width) of a convolution or pooling
    padding: str
    strides: tuple[int, int]
    window: tuple[int, int]
    value: np.ndarray | None  # Value of a constant; ``None`` for other nodes


def read_graph(content: bytes) -> dict[str, GraphNode]:
    """Read the nodes of a serialised ``GraphDef`` by name, in the graph's order.

    Raises ``ModelError`` if the content is damaged or is not such a graph.
    """
    try:
        graph = _graph_class().FromString(content)
        return {node.name: _node(node) for node in graph.node}
    except (DecodeError, ValueError, KeyError) as error:
        raise ModelError("The TensorFlow graph is damaged or has another format.") from error


def _graph_class() -> Any:
    file = descriptor_pb2.FileDescriptorProto(name="frozen_graph.proto", package="frozen", syntax="proto3")
    for message, fields in _SCHEMA.items():
        declared = file.message_type.add(name=message)
        for name, (number, kind, is_repeated) in fields.items():
            field = declared.field.add(name=name, number=number)
            field.label = _Field.LABEL_REPEATED if is_repeated else _Field.LABEL_OPTIONAL
            if isinstance(kind, str):
                field.type, field.type_name = _Field.TYPE_MESSAGE, f".frozen.{kind}"
            else:
                field.type = kind
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName("frozen.Graph"))


def _node(node: Any) -> GraphNode:
    values = {entry.key: entry.value for entry in node.attr}
    if "data_format" in values and values["data_format"].s not in {b"", b"NHWC"}:
        raise ModelError("The TensorFlow graph's channels are not last, which is not supported.")

    def height_and_width(key: str) -> tuple[int, int]:
        return tuple(values[key].list.i[1:3]) if key in values else (1, 1)

    return GraphNode(
        name=node.name,
        kind=node.op,
        inputs=tuple(name.partition(":")[0] for name in node.input),
        padding=values["padding"].s.decode() if "padding" in values else "",
        strides=height_and_width("strides"),
        window=height_and_width("ksize"),
        value=_array(values["value"].tensor) if node.op == "Const" else None,
    )


def _array(tensor: Any) -> np.ndarray:
    dtype = _DTYPES[tensor.dtype]
    shape = tuple(dim.size for dim in tensor.shape.dim)
    if tensor.content:
        return np.frombuffer(tensor.content, dtype).reshape(shape)
    values = np.array(tensor.floats if dtype == np.float32 else tensor.ints, dtype)
    # A single value stands for all elements.
    return np.full(shape, values[0], dtype) if values.size == 1 else values.reshape(shape)


def convert(content: bytes, input_name: str, source: str, outputs: Mapping[str, int]) -> bytes:
    """Convert the graph from its placeholder to one of its nodes to a serialised ONNX model, float32 and NCHW.

    ``content``: serialised ``GraphDef`` whose variables are constants. ``input_name``: name in ONNX of the input image,
    which has three channels. ``source``, ``outputs``: node whose channels are split into the outputs, and the number of
    channels of each output by name. Raises ``ModelError`` if the graph is damaged, lacks a node, or has an operation
    that is not supported.
    """
    conversion = _Conversion(read_graph(content), input_name)
    conversion.onnx.emit_split(conversion.activation(source), dict(outputs))
    return conversion.onnx.encode({input_name: 3}, dict(outputs))


class _Conversion(OnDemandConversion[str]):
    """Conversion of nodes, by name."""

    def __init__(self, nodes: Mapping[str, GraphNode], input_name: str) -> None:
        super().__init__()
        self._nodes = nodes
        self._input_name = input_name

    def convert(self, name: str) -> str:
        """Convert a node; the placeholder is the input image."""
        node = self.node(name)
        if (handler := _HANDLERS.get(node.kind)) is None:
            raise ModelError(f"The TensorFlow graph needs {node.kind}, which is not supported.")
        return self._input_name if node.kind == "Placeholder" else handler(self, node)

    def node(self, name: str) -> GraphNode:
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


def _convolution(conversion: _Conversion, node: GraphNode, bias: str | None = None) -> str:
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


def _bias(conversion: _Conversion, node: GraphNode) -> str:
    convolution = conversion.node(node.inputs[0])
    if convolution.kind not in {"Conv2D", "DepthwiseConv2dNative"}:
        raise ModelError(f"The TensorFlow graph adds a bias to {convolution.kind}, which is not supported.")
    return _convolution(conversion, convolution, node.inputs[1])


def _relu(conversion: _Conversion, node: GraphNode) -> str:
    return conversion.onnx.emit("Relu", [conversion.activation(node.inputs[0])], node.name)


def _max_pool(conversion: _Conversion, node: GraphNode) -> str:
    return conversion.onnx.emit(
        "MaxPool",
        [conversion.activation(node.inputs[0])],
        node.name,
        auto_pad=_padding(node),
        kernel_shape=list(node.window),
        strides=list(node.strides),
    )


def _concatenation(conversion: _Conversion, node: GraphNode) -> str:
    *sources, axis = node.inputs
    if int(conversion.constant(axis)) not in _CHANNELS_LAST:
        raise ModelError("The TensorFlow graph joins other axes than channels, which is not supported.")
    return conversion.onnx.emit("Concat", [conversion.activation(name) for name in sources], node.name, axis=1)


def _padding(node: GraphNode) -> str:
    # TensorFlow's SAME pads the odd pixel at the end.
    return "SAME_UPPER" if node.padding == "SAME" else "VALID"


_Handler = Callable[[_Conversion, GraphNode], str]
_HANDLERS: dict[str, _Handler] = {
    "Placeholder": lambda conversion, node: node.name,
    "Conv2D": _convolution,
    "DepthwiseConv2dNative": _convolution,
    "BiasAdd": _bias,
    "Relu": _relu,
    "MaxPool": _max_pool,
    "ConcatV2": _concatenation,
}
