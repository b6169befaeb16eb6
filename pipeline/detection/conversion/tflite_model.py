"""Reader of TensorFlow Lite models: tensors, operators and their options."""

import struct
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import tflite

from pipeline.core.errors import ModelError

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
