"""Conversion of a frozen graph with all supported kinds of nodes, compared with NumPy."""

import numpy as np
import onnxruntime
import pytest

from pipeline.core.errors import ModelError
from pipeline.detection.conversion.tf_to_onnx import _graph_class, convert, read_graph

RNG = np.random.default_rng(7)
KERNEL = RNG.normal(size=(1, 1, 3, 4)).astype(np.float32)
DEPTHWISE = RNG.normal(size=(1, 1, 4, 1)).astype(np.float32)
BIAS = RNG.normal(size=4).astype(np.float32)


class GraphBuilder:
    """Builder of a serialised graph."""

    def __init__(self) -> None:
        self.message = _graph_class()()

    def add(self, name: str, kind: str, *inputs: str, **attributes: object) -> str:
        node = self.message.node.add(name=name, op=kind, input=inputs)
        for key, value in attributes.items():
            entry = node.attr.add(key=key)
            if isinstance(value, str):
                entry.value.s = value.encode()
            else:
                entry.value.list.i.extend(value)
        return name

    def constant(self, name: str, value: np.ndarray, single: bool = False) -> str:
        tensor = self.message.node.add(name=name, op="Const").attr.add(key="value").value.tensor
        tensor.dtype = 1 if value.dtype == np.float32 else 3
        for size in value.shape:
            tensor.shape.dim.add(size=size)
        if single:
            tensor.ints.append(int(value))
        else:
            tensor.content = value.tobytes()
        return name

    def encode(self) -> bytes:
        return bytes(self.message.SerializeToString())


def small_network(padding: str = "SAME", kind: str = "Relu") -> GraphBuilder:
    graph = GraphBuilder()
    graph.add("image", "Placeholder")
    options = {"padding": padding, "strides": (1, 1, 1, 1), "data_format": "NHWC"}
    graph.add("conv", "Conv2D", "image", graph.constant("kernel", KERNEL), **options)
    graph.add("biased", "BiasAdd", "conv", graph.constant("bias", BIAS))
    graph.add("relu", kind, "biased:0")
    graph.add("depthwise", "DepthwiseConv2dNative", "relu", graph.constant("weights", DEPTHWISE), **options)
    graph.add("pool", "MaxPool", "depthwise", padding="SAME", strides=(1, 1, 1, 1), ksize=(1, 2, 2, 1))
    graph.add("joined", "ConcatV2", "relu", "pool", graph.constant("axis", np.array(3, np.int32), single=True))
    return graph


def run(model: bytes, image: np.ndarray) -> dict[str, np.ndarray]:
    session = onnxruntime.InferenceSession(model)
    names = [output.name for output in session.get_outputs()]
    return dict(zip(names, session.run(names, {"image": image}), strict=True))


def test_every_kind_of_node_does_what_it_does() -> None:
    image = RNG.normal(size=(1, 3, 5, 6)).astype(np.float32)
    model = convert(small_network().encode(), "image", "joined", {"first": 4, "second": 4})
    assert convert(small_network().encode(), "image", "joined", {"first": 4, "second": 4}) == model
    found = run(model, image)
    relu = np.maximum(np.einsum("nchw,co->nohw", image, KERNEL[0, 0]) + BIAS[:, None, None], 0)
    np.testing.assert_allclose(found["first"], relu, rtol=1e-5, atol=1e-6)
    deep = np.pad(
        relu * DEPTHWISE[0, 0, :, 0][:, None, None], ((0, 0), (0, 0), (0, 1), (0, 1)), constant_values=-np.inf
    )
    shifted = [deep[:, :, dy : dy + 5, dx : dx + 6] for dy in (0, 1) for dx in (0, 1)]
    np.testing.assert_allclose(found["second"], np.max(shifted, axis=0), rtol=1e-5, atol=1e-6)


def test_single_value_stands_for_all() -> None:
    graph = GraphBuilder()
    tensor = graph.message.node.add(name="zeros", op="Const").attr.add(key="value").value.tensor
    tensor.dtype = 1
    tensor.shape.dim.add(size=3)
    tensor.floats.append(0.5)
    np.testing.assert_array_equal(read_graph(graph.encode())["zeros"].value, [0.5, 0.5, 0.5])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"\xff\xff", "damaged or has another format"),
        (small_network(kind="Tanh").encode(), "needs Tanh, which is not supported"),
        (GraphBuilder().encode(), "has no node joined"),
    ],
)
def test_conversion_impossible_is_reported(content: bytes, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        convert(content, "image", "joined", {"first": 4, "second": 4})
