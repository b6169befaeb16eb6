"""Read an OpenVINO IR (version 10) into plain records: layers by number, constants unpacked.

The format: https://docs.openvino.ai, "OpenVINO IR format". Constants lie in a binary file beside the XML.
"""

from dataclasses import dataclass
from xml.etree.ElementTree import Element, ParseError

import numpy as np
from defusedxml import DefusedXmlException, ElementTree

from pipeline.errors import ModelError

_DTYPES = {"f16": np.float16, "f32": np.float32, "i8": np.int8, "u8": np.uint8, "i64": np.int64, "i32": np.int32}


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """An operation.

    Parameters
    ----------
    name, kind
        Such as ``conv1`` and ``Convolution``.
    inputs
        Numbers of the layers that its input ports are connected to, in order.
    options
        Attributes of the kind, as text.
    num_channels
        Of what it makes, 0 where that is no image.
    value
        Of a constant, half precision widened.
    """

    name: str
    kind: str
    inputs: tuple[str, ...]
    options: dict[str, str]
    num_channels: int
    value: np.ndarray | None

    def whole_numbers(self, option: str) -> list[int]:
        """An option that is a list of whole numbers."""
        return [int(text) for text in self.options[option].split(",")]


def read_ir(xml: bytes, weights: bytes) -> dict[str, Layer]:
    """Layers by number.

    Raises
    ------
    ModelError
        If the files are no IR, are damaged, or don't belong to each other.
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
        raise ModelError("The OpenVINO network is damaged, or is none.") from error


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
