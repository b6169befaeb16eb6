"""Reader of frozen TensorFlow graphs, without TensorFlow.

Messages and field numbers: TensorFlow's ``core/framework/{graph,node_def,attr_value,tensor}.proto``. Only the fields of
a frozen graph of convolutions are declared; protobuf skips other fields.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import DecodeError

from pipeline.errors import ModelError

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
class Node:
    """Node of a graph.

    Parameters
    ----------
    name, kind
        Name and operation of the node, such as ``conv1/Relu`` and ``Relu``.
    inputs
        Names of the input nodes.
    padding, strides, window
        Kind of the padding, strides (height, width) and window (height, width) of a convolution or pooling.
    value
        Value of a constant; ``None`` for other nodes.
    """

    name: str
    kind: str
    inputs: tuple[str, ...]
    padding: str
    strides: tuple[int, int]
    window: tuple[int, int]
    value: np.ndarray | None


def read_graph(content: bytes) -> dict[str, Node]:
    """Read the nodes of a serialised ``GraphDef`` by name, in the graph's order.

    Raises
    ------
    ModelError
        If the content is damaged or is not such a graph.
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


def _node(node: Any) -> Node:
    values = {entry.key: entry.value for entry in node.attr}
    if "data_format" in values and values["data_format"].s not in {b"", b"NHWC"}:
        raise ModelError("The TensorFlow graph's channels are not last, which is not supported.")

    def height_and_width(key: str) -> tuple[int, int]:
        return tuple(values[key].list.i[1:3]) if key in values else (1, 1)

    return Node(
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
