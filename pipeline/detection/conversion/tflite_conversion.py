"""Base of the conversion of TensorFlow Lite operators: constants, operands and fused activation functions."""

from collections.abc import Callable, Mapping

import numpy as np
import tflite

from pipeline.core.errors import ModelError
from pipeline.detection.conversion.onnx_graph import OnDemandConversion
from pipeline.detection.conversion.tflite_model import Graph, Operator

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
