"""Reader of OpenVINO IR networks (version 10): layers by number, with constants unpacked.

Format: https://docs.openvino.ai, "OpenVINO IR format". Constants are in a binary file beside the XML file.
"""

from dataclasses import dataclass
from xml.etree.ElementTree import Element, ParseError

import numpy as np
from defusedxml import DefusedXmlException, ElementTree

from pipeline.errors import ModelError

_DTYPES = {"f16": np.float16, "f32": np.float32, "i8": np.int8, "u8": np.uint8, "i64": np.int64, "i32": np.int32}


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """Layer of a network.

    Parameters
    ----------
    name, kind
        Name and type of the operation, such as ``conv1`` and ``Convolution``.
    inputs
        Numbers of the layers that are connected to the input ports, in order of the ports.
    options
        Attributes of the operation, as text.
    num_channels
        Number of channels of the output, 0 if it has not four axes.
    value
        Value of a constant, half precision converted to single; ``None`` for other layers.
    """

    name: str
    kind: str
    inputs: tuple[str, ...]
    options: dict[str, str]
    num_channels: int
    value: np.ndarray | None

    def whole_numbers(self, option: str) -> list[int]:
        """Parse an option that is a list of whole numbers."""
        return [int(text) for text in self.options[option].split(",")]


def read_ir(xml: bytes, weights: bytes) -> dict[str, Layer]:
    """Read the layers of a network, by number.

    Parameters
    ----------
    xml, weights
        Contents of the XML file and of the binary file.

    Raises
    ------
    ModelError
        If the files are damaged, are not an IR, or do not belong together.
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
