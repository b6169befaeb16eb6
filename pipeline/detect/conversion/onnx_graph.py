"""An ONNX graph under construction, written as the same bytes every time."""

from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

# Pinned, so that the same weights give the same bytes whatever release of onnx writes them.
_OPSET = 13
_IR_VERSION = 8


class OnnxGraph:
    """Nodes and constants so far. Activations are float32, NCHW; batch, height and width stay open."""

    def __init__(self) -> None:
        self._nodes: list[onnx.NodeProto] = []
        self._constants: dict[str, onnx.TensorProto] = {}

    def emit(self, kind: str, inputs: list[str], output: str, **attributes: Any) -> str:
        """Append a node; returns the name of its output."""
        self._nodes.append(helper.make_node(kind, inputs, [output], **attributes))
        return output

    def emit_split(self, source: str, sizes: dict[str, int]) -> None:
        """Split a tensor's channels into outputs of so many each."""
        lengths = self.add_constant(f"{source}_sizes", np.array(list(sizes.values()), np.int64))
        self._nodes.append(helper.make_node("Split", [source, lengths], list(sizes), axis=1))

    def add_constant(self, name: str, value: np.ndarray) -> str:
        """Add a constant under its name; returns the name."""
        self._constants[name] = numpy_helper.from_array(np.ascontiguousarray(value), name)
        return name

    def encode(self, inputs: dict[str, int], outputs: dict[str, int]) -> bytes:
        """The ONNX model, checked.

        Parameters
        ----------
        inputs, outputs
            Names and numbers of channels.
        """
        body = helper.make_graph(
            self._nodes,
            "network",
            [_value_info(name, num_channels) for name, num_channels in inputs.items()],
            [_value_info(name, num_channels) for name, num_channels in outputs.items()],
            list(self._constants.values()),
        )
        model = helper.make_model(body, opset_imports=[helper.make_opsetid("", _OPSET)], ir_version=_IR_VERSION)
        onnx.checker.check_model(model)
        return bytes(model.SerializeToString(deterministic=True))


def _value_info(name: str, num_channels: int) -> onnx.ValueInfoProto:
    shape: list[str | int | None] = ["batch", num_channels, f"{name}_height", f"{name}_width"]
    return helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)
