"""Conversion of a quantised OpenVINO IR network to a float32 ONNX model, without OpenVINO.

Weights are unpacked from eight bits. The quantisation of activations is left out: it saves memory on hardware with
byte arithmetic, and costs accuracy elsewhere. Semantics of layers: OpenVINO's specification of operation set 4.

Format: https://docs.openvino.ai, "OpenVINO IR format" (version 10). Constants are in a binary file beside the XML file.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from xml.etree.ElementTree import Element, ParseError

import numpy as np
from defusedxml import DefusedXmlException, ElementTree

from pipeline.core.errors import ModelError
from pipeline.detection.conversion.onnx_graph import OnDemandConversion

_DTYPES = {"f16": np.float16, "f32": np.float32, "i8": np.int8, "u8": np.uint8, "i64": np.int64, "i32": np.int32}


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """Layer of a network."""

    # Name and type of the operation, such as ``conv1`` and ``Convolution``
    name: str
    kind: str
    inputs: tuple[str, ...]  # Numbers of the layers that are connected to the input ports, in order of the ports
    options: dict[str, str]  # Attributes of the operation, as text
    num_channels: int  # Number of channels of the output, 0 if it has not four axes
    value: np.ndarray | None  # Value of a constant, half precision converted to single; ``None`` for other layers

    def whole_numbers(self, option: str) -> list[int]:
        """Parse an option that is a list of whole numbers."""
        return [int(text) for text in self.options[option].split(",")]


def read_ir(xml: bytes, weights: bytes) -> dict[str, Layer]:
    """Read the layers of a network, by number.

    The contents are the bytes of the XML file and of the binary file. Raises ``ModelError`` if they are damaged, are
    not an IR, or do not belong together.
    """
    try:
        root = ElementTree.fromstring(xml)
        sources: dict[str, dict[int, str]] = {}
        for edge in root.iterfind("edges/edge"):
            sources.setdefault(edge.attrib["to-layer"], {})[int(edge.attrib["to-port"])] = edge.attrib["from-layer"]
        return {
            layer.attrib["id"]: _layer(layer, sources.get(layer.attrib["id"], {}), weights)
            for layer in root.iterfind("layers/layer")
        }
    except (ParseError, DefusedXmlException, KeyError, ValueError) as error:
        raise ModelError("The OpenVINO network is damaged or has another format.") from error


def _layer(element: Element, sources: dict[int, str], weights: bytes) -> Layer:
    data = element.find("data")
    options = {} if data is None else dict(data.attrib)
    dims = [int(dim.text or "") for dim in element.iterfind("output/port/dim")]
    return Layer(
        name=element.attrib["name"],
        kind=element.attrib["type"],
        inputs=tuple(sources[port] for port in sorted(sources)),
        options=options,
        num_channels=dims[1] if len(dims) == 4 else 0,
        value=_constant(options, weights) if element.attrib["type"] == "Const" else None,
    )


def _constant(options: dict[str, str], weights: bytes) -> np.ndarray:
    shape = [int(size) for size in options["shape"].split(",")] if options["shape"] else []
    start, size = int(options["offset"]), int(options["size"])
    value = np.frombuffer(weights[start : start + size], _DTYPES[options["element_type"]]).reshape(shape)
    return value.astype(np.float32) if value.dtype == np.float16 else value


def convert(xml: bytes, weights: bytes, input_name: str, outputs: Mapping[str, int]) -> bytes:
    """Convert a whole network to a serialised ONNX model, float32 and NCHW.

    ``xml``, ``weights``: contents of the XML file and of the binary file. ``input_name``: name in ONNX of the input
    image, which has three channels. ``outputs``: number of channels of each output by its name in ONNX; outputs are
    identified by this number. Raises ``ModelError`` if the network is damaged, lacks an output, or has a layer that is
    not supported.
    """
    layers = read_ir(xml, weights)
    conversion = _Conversion(layers, input_name)
    nodes = {
        layers[layer.inputs[0]].num_channels: layer.inputs[0] for layer in layers.values() if layer.kind == "Result"
    }
    for name, num_channels in outputs.items():
        if num_channels not in nodes:
            raise ModelError(f"The OpenVINO network has no output of {num_channels} channels: it is another network.")
        conversion.onnx.emit("Identity", [conversion.activation(nodes[num_channels])], name)
    return conversion.onnx.encode({input_name: 3}, dict(outputs))


class _Conversion(OnDemandConversion[str]):
    """Conversion of layers, by number."""

    def __init__(self, layers: Mapping[str, Layer], input_name: str) -> None:
        super().__init__()
        self._layers = layers
        self._input_name = input_name
        self._constants: dict[str, np.ndarray | None] = {}

    def convert(self, number: str) -> str:
        """Convert a layer; a quantisation is replaced by its input."""
        layer = self._layers[number]
        if layer.kind == "Parameter":
            return self._input_name
        if layer.kind == "FakeQuantize":
            return self.activation(layer.inputs[0])
        if (handler := _HANDLERS.get(layer.kind)) is None:
            raise ModelError(f"The OpenVINO network needs {layer.kind}, which is not supported.")
        return handler(self, layer, f"l{number}")

    def operand(self, number: str) -> str:
        """ONNX name of an operand of elementwise arithmetic: a constant or an activation."""
        value = self.constant(number)
        if value is None:
            return self.activation(number)
        return self.onnx.add_constant(f"c{number}", value.astype(np.float32))

    def weights(self, number: str) -> np.ndarray:
        """Value of a constant layer; ``ModelError`` if the layer is not constant."""
        value = self.constant(number)
        if value is None:
            raise ModelError("The OpenVINO network has weights of a kind that is not supported.")
        return value

    def constant(self, number: str) -> np.ndarray | None:
        """Value of a layer that depends on constants only; ``None`` for a layer that depends on the image."""
        if number not in self._constants:
            self._constants[number] = self._fold(self._layers[number])
        return self._constants[number]

    def _fold(self, layer: Layer) -> np.ndarray | None:
        if layer.kind == "Const":
            return layer.value
        if layer.kind not in {"Convert", "Reshape", "FakeQuantize"}:
            return None
        values = [self.constant(number) for number in layer.inputs]
        known = [value for value in values if value is not None]
        if len(known) < len(values):
            return None
        if layer.kind == "Convert":
            return known[0].astype(np.float32)
        if layer.kind == "Reshape":
            return known[0].reshape(known[1].tolist())
        return _dequantise(known, int(layer.options["levels"]))


def _dequantise(values: list[np.ndarray], levels: int) -> np.ndarray:
    """Apply FakeQuantize to a constant: map the input range to the nearest level of the output range."""
    value, low, high, low_out, high_out = (operand.astype(np.float32) for operand in values)
    level = np.round((np.clip(value, low, high) - low) / (high - low) * np.float32(levels - 1))
    return np.asarray(level / np.float32(levels - 1) * (high_out - low_out) + low_out, np.float32)


def _convolution(conversion: _Conversion, layer: Layer, name: str) -> str:
    """Convert a convolution; weights are (output channels, input channels, height, width), with groups first if any."""
    weights = conversion.weights(layer.inputs[1])
    num_groups = 1
    if layer.kind == "GroupConvolution":
        num_groups = len(weights)
        weights = weights.reshape(-1, *weights.shape[2:])
    return conversion.onnx.emit(
        "Conv",
        [
            conversion.activation(layer.inputs[0]),
            conversion.onnx.add_constant(f"{name}_weights", weights.astype(np.float32)),
        ],
        name,
        group=num_groups,
        kernel_shape=list(weights.shape[2:]),
        strides=layer.whole_numbers("strides"),
        dilations=layer.whole_numbers("dilations"),
        pads=[*layer.whole_numbers("pads_begin"), *layer.whole_numbers("pads_end")],
    )


def _elementwise(kind: str) -> "_Handler":
    def handle(conversion: _Conversion, layer: Layer, name: str) -> str:
        return conversion.onnx.emit(kind, [conversion.operand(number) for number in layer.inputs], name)

    return handle


def _relu(conversion: _Conversion, layer: Layer, name: str) -> str:
    return conversion.onnx.emit("Relu", [conversion.activation(layer.inputs[0])], name)


def _elu(conversion: _Conversion, layer: Layer, name: str) -> str:
    source = conversion.activation(layer.inputs[0])
    return conversion.onnx.emit("Elu", [source], name, alpha=float(layer.options["alpha"]))


def _concatenation(conversion: _Conversion, layer: Layer, name: str) -> str:
    sources = [conversion.activation(number) for number in layer.inputs]
    return conversion.onnx.emit("Concat", sources, name, axis=int(layer.options["axis"]))


_Handler = Callable[[_Conversion, Layer, str], str]
_HANDLERS: dict[str, _Handler] = {
    "Convolution": _convolution,
    "GroupConvolution": _convolution,
    "Add": _elementwise("Add"),
    "Multiply": _elementwise("Mul"),
    "ReLU": _relu,
    "Elu": _elu,
    "Concat": _concatenation,
}
