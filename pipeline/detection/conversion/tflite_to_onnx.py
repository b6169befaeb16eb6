"""Conversion of a float TensorFlow Lite model, or a part of it, to ONNX, without TensorFlow.

Activations change from NHWC to NCHW, weights from half to single precision, which is exact. Only the part between the
chosen inputs and outputs is converted: the model's own decoding is left out.
"""

from collections.abc import Mapping

from pipeline.core.errors import ModelError
from pipeline.detection.conversion.onnx_graph import Axes
from pipeline.detection.conversion.tflite_conversion import NCHW_FROM_NHWC, TfliteConversion
from pipeline.detection.conversion.tflite_model import Graph, read_model
from pipeline.detection.conversion.tflite_operators import HANDLERS


def convert(model: bytes, inputs: Mapping[str, str], outputs: Mapping[str, str], is_fixed: bool = False) -> bytes:
    """Convert the part of a model between some of its tensors to a serialised ONNX model, float32 and NCHW.

    Parameters
    ----------
    model
        TensorFlow Lite flatbuffer.
    inputs, outputs
        Names in ONNX by names in TensorFlow Lite, up to the first semicolon.
    is_fixed
        Whether height and width are the model's; otherwise they are open.

    Raises
    ------
    ModelError
        If the model is damaged, lacks a tensor, or has an operator that is not supported.
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
