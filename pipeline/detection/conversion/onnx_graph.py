"""Construction of ONNX graphs with reproducible bytes, and the base of conversions from other formats."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, Generic, TypeVar

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

# Pinned, so that the same weights give the same bytes with every release of onnx.
_OPSET = 13
_IR_VERSION = 8

Axes = int | tuple[int, ...]
"""Shape of a tensor without its batch: all axes, or the number of channels of a map whose height and width are open."""

_Key = TypeVar("_Key", str, int)


class OnnxGraph:
    """ONNX graph under construction; activations are float32 and NCHW, with an open batch."""

    def __init__(self) -> None:
        self._nodes: list[onnx.NodeProto] = []
        self._constants: dict[str, onnx.TensorProto] = {}

    def emit(self, kind: str, inputs: list[str], output: str, **attributes: Any) -> str:
        """Append a node; return the name of its output."""
        self._nodes.append(helper.make_node(kind, inputs, [output], **attributes))
        return output

    def emit_split(self, source: str, sizes: dict[str, int]) -> None:
        """Split the channels of a tensor; ``sizes`` holds the number of channels of each output by name."""
        lengths = self.add_constant(f"{source}_sizes", np.array(list(sizes.values()), np.int64))
        self._nodes.append(helper.make_node("Split", [source, lengths], list(sizes), axis=1))

    def add_constant(self, name: str, value: np.ndarray) -> str:
        """Add a constant under a name; return the name."""
        self._constants[name] = numpy_helper.from_array(np.ascontiguousarray(value), name)
        return name

    def encode(self, inputs: Mapping[str, Axes], outputs: Mapping[str, Axes]) -> bytes:
        """Check the model and serialise it; the same graph gives the same bytes. Shapes are by name."""
        body = helper.make_graph(
            self._nodes,
            "network",
            [_value_info(name, axes) for name, axes in inputs.items()],
            [_value_info(name, axes) for name, axes in outputs.items()],
            list(self._constants.values()),
        )
        model = helper.make_model(body, opset_imports=[helper.make_opsetid("", _OPSET)], ir_version=_IR_VERSION)
        onnx.checker.check_model(model)
        return bytes(model.SerializeToString(deterministic=True))


class OnDemandConversion(ABC, Generic[_Key]):
    """Conversion of a network's operations to ONNX, each when its output is first needed.

    ``names`` are those in ONNX of the network's inputs, by key.
    """

    def __init__(self, names: dict[_Key, str] | None = None) -> None:
        self.onnx = OnnxGraph()
        self._names: dict[_Key, str] = dict(names or {})

    def activation(self, key: _Key) -> str:
        """Name in ONNX of an operation's output."""
        if key not in self._names:
            self._names[key] = self.convert(key)
        return self._names[key]

    @abstractmethod
    def convert(self, key: _Key) -> str:
        """Convert an operation; return the name in ONNX of its output."""


def _value_info(name: str, axes: Axes) -> onnx.ValueInfoProto:
    shape = axes if isinstance(axes, tuple) else (axes, f"{name}_height", f"{name}_width")
    return helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", *shape])
