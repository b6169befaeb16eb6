"""Conversion of a small quantised IR, compared with NumPy."""

import numpy as np
import onnxruntime
import pytest

from pipeline.core.errors import ModelError
from pipeline.detection.conversion.ir_to_onnx import convert

RNG = np.random.default_rng(8)
LEVELS = RNG.integers(0, 256, (4, 3, 1, 1)).astype(np.uint8)
GROUPS = RNG.normal(size=(4, 1, 1, 1, 1)).astype(np.float16)


class Ir:
    """Builder of the XML file and the binary file."""

    def __init__(self) -> None:
        self.layers: list[str] = []
        self.edges: list[str] = []
        self.weights = b""

    def add(self, kind: str, *inputs: int, channels: int = 0, **options: object) -> int:
        number = len(self.layers)
        data = " ".join(f'{key}="{value}"' for key, value in options.items())
        dims = f"<dim>1</dim><dim>{channels}</dim><dim>5</dim><dim>6</dim>" if channels else ""
        self.layers.append(
            f'<layer id="{number}" name="n{number}" type="{kind}"><data {data}/>'
            f"<output><port>{dims}</port></output></layer>"
        )
        for port, source in enumerate(inputs):
            self.edges.append(f'<edge from-layer="{source}" from-port="9" to-layer="{number}" to-port="{port}"/>')
        return number

    def constant(self, value: np.ndarray) -> int:
        kind = {"float16": "f16", "float32": "f32", "uint8": "u8", "int64": "i64"}[str(value.dtype)]
        shape = ",".join(str(size) for size in value.shape)
        number = self.add("Const", element_type=kind, offset=len(self.weights), size=value.nbytes, shape=shape)
        self.weights += value.tobytes()
        return number

    def files(self) -> tuple[bytes, bytes]:
        xml = f"<net><layers>{''.join(self.layers)}</layers><edges>{''.join(self.edges)}</edges></net>"
        return xml.encode(), self.weights


def small_network(kind: str = "Elu") -> Ir:
    ir = Ir()
    image = ir.add("Parameter", channels=3, element_type="f16", shape="1,3,5,6")
    scaled = ir.add("Multiply", image, ir.constant(np.full((1, 1, 1, 1), 0.5, np.float16)), channels=3)
    bounds = [ir.constant(np.array(bound, np.float16)) for bound in (0.0, 255.0, -1.0, 1.0)]
    quantised = ir.add("FakeQuantize", scaled, *bounds, channels=3, levels=256)  # of the image: left out
    widened = ir.add("Convert", ir.constant(LEVELS), destination_type="f16")
    weights = ir.add("FakeQuantize", widened, *bounds, levels=256)
    options = {"strides": "1,1", "dilations": "1,1", "pads_begin": "0,0", "pads_end": "0,0"}
    conv = ir.add("Convolution", quantised, weights, channels=4, **options)
    grouped = ir.add("Reshape", ir.constant(GROUPS.reshape(4, 1)), ir.constant(np.array(GROUPS.shape, np.int64)))
    depthwise = ir.add("GroupConvolution", ir.add("ReLU", conv, channels=4), grouped, channels=4, **options)
    elu = ir.add(kind, ir.add("Add", depthwise, conv, channels=4), channels=4, alpha="1.0")
    ir.add("Result", elu)
    ir.add("Result", ir.add("Concat", elu, conv, channels=8, axis=1))
    return ir


def test_every_kind_of_layer_does_what_it_does() -> None:
    image = RNG.normal(size=(1, 3, 5, 6)).astype(np.float32)
    model = convert(*small_network().files(), "image", {"few": 4, "many": 8})
    assert convert(*small_network().files(), "image", {"few": 4, "many": 8}) == model
    found = onnxruntime.InferenceSession(model).run(["few", "many"], {"image": image})
    weights = LEVELS[:, :, 0, 0].astype(np.float32) / 255 * 2 - 1
    conv = np.einsum("nchw,oc->nohw", image * 0.5, weights)
    total = np.maximum(conv, 0) * GROUPS.astype(np.float32)[:, 0, 0] + conv
    elu = np.where(total > 0, total, np.expm1(total))
    np.testing.assert_allclose(found[0], elu, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(found[1], np.concatenate([elu, conv], axis=1), rtol=1e-4, atol=1e-5)


def test_conversion_impossible_is_reported() -> None:
    xml, weights = small_network("Tanh").files()
    with pytest.raises(ModelError, match="needs Tanh, which is not supported"):
        convert(xml, weights, "image", {"few": 4, "many": 8})
    xml, weights = small_network().files()
    with pytest.raises(ModelError, match="no output of 19 channels"):
        convert(xml, weights, "image", {"heatmaps": 19})
    with pytest.raises(ModelError, match="damaged or has another format"):
        convert(xml, weights[:20], "image", {"few": 4, "many": 8})
    for broken in (b"<net>", b'<!DOCTYPE net [<!ENTITY a "b">]><net>&a;</net>'):
        with pytest.raises(ModelError, match=r"damaged or has another format|no output"):
            convert(broken, weights, "image", {"few": 4, "many": 8})
