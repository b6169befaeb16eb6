from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import onnx
import onnxruntime
import pytest
import tflite

from pipeline.core.errors import ModelError
from pipeline.detection.conversion.tflite_to_onnx import Graph, Operator, Tensor, convert_graph, read_model

RANDOM = np.random.default_rng(0)
SAME, VALID = tflite.Padding.SAME, tflite.Padding.VALID
NONE, RELU, RELU6, TANH = 0, 1, 3, 4


def options(**values: int) -> SimpleNamespace:
    """Options as methods, like the tables of the schema."""
    return SimpleNamespace(**{name: (lambda value=value: value) for name, value in values.items()})


def convolution_options(stride: int, padding: int, activation: int = NONE, dilation: int = 1) -> SimpleNamespace:
    return options(
        StrideH=stride,
        StrideW=stride,
        Padding=padding,
        FusedActivationFunction=activation,
        DilationHFactor=dilation,
        DilationWFactor=dilation,
        DepthMultiplier=1,
    )


def graph_of(kind: str, constants: Sequence[np.ndarray], channels: int, operator_options: Any) -> Graph:
    """Graph of a single operator from the image, and constants, to the result."""
    tensors = [Tensor("image", (1, 1, 1, 3), None)]
    tensors += [Tensor(f"constant{k}", value.shape, value) for k, value in enumerate(constants)]
    tensors.append(Tensor("result;fused/name", (1, 1, 1, channels), None))
    inputs = tuple(range(len(tensors) - 1))
    return Graph(tuple(tensors), (Operator(kind, inputs, (len(tensors) - 1,), operator_options),))


def run(graph: Graph, image: np.ndarray) -> np.ndarray:
    """Result (height, width, channels) of a converted graph for an image (height, width, channels)."""
    model = convert_graph(graph, {"image": "input"}, {"result": "output"})
    session = onnxruntime.InferenceSession(model, providers=["CPUExecutionProvider"])
    (result,) = session.run(["output"], {"input": image.transpose(2, 0, 1)[None].astype(np.float32)})
    return np.asarray(result)[0].transpose(1, 2, 0)


def convolve(image: np.ndarray, weights: np.ndarray, stride: int, padding: int) -> np.ndarray:
    """Convolution as TensorFlow computes it; weights are (out, height, width, in)."""
    size = np.array(weights.shape[1:3])
    shape = np.array(image.shape[:2])
    if padding == SAME:
        out = -(-shape // stride)
        total = np.maximum((out - 1) * stride + size - shape, 0)
        image = np.pad(image, [*((t // 2, t - t // 2) for t in total), (0, 0)])
    else:
        out = (shape - size) // stride + 1
    return np.array(
        [
            [
                np.einsum(
                    "hwi,ohwi->o",
                    image[y * stride : y * stride + size[0], x * stride : x * stride + size[1]],
                    weights,
                )
                for x in range(out[1])
            ]
            for y in range(out[0])
        ]
    )


@pytest.mark.parametrize("shape", [(8, 10), (9, 7)])
@pytest.mark.parametrize(("stride", "padding"), [(1, SAME), (2, SAME), (1, VALID), (2, VALID)])
def test_convolution(shape: tuple[int, int], stride: int, padding: int) -> None:
    image = RANDOM.normal(size=(*shape, 3))
    weights, bias = RANDOM.normal(size=(5, 3, 3, 3)).astype(np.float32), RANDOM.normal(size=5).astype(np.float32)
    graph = graph_of("CONV_2D", [weights, bias], 5, convolution_options(stride, padding))
    expected = convolve(image, weights, stride, padding) + bias
    np.testing.assert_allclose(run(graph, image), expected, atol=1e-4)


def test_convolution_in_half_precision_without_bias() -> None:
    image = RANDOM.normal(size=(4, 4, 3))
    weights = RANDOM.normal(size=(2, 1, 1, 3)).astype(np.float16)
    tensors = (
        Tensor("image", (1, 1, 1, 3), None),
        Tensor("half", weights.shape, weights),
        Tensor("weights", weights.shape, None),
        Tensor("result", (1, 1, 1, 2), None),
    )
    operators = (
        Operator("DEQUANTIZE", (1,), (2,), None),
        Operator("CONV_2D", (0, 2, -1), (3,), convolution_options(1, SAME)),
    )
    expected = convolve(image, weights.astype(np.float32), 1, SAME)
    np.testing.assert_allclose(run(Graph(tensors, operators), image), expected, atol=1e-5)


@pytest.mark.parametrize("stride", [1, 2])
def test_depthwise_convolution(stride: int) -> None:
    image = RANDOM.normal(size=(8, 9, 3))
    weights = RANDOM.normal(size=(1, 5, 3, 3)).astype(np.float32)
    graph = graph_of("DEPTHWISE_CONV_2D", [weights], 3, convolution_options(stride, SAME))
    expected = np.concatenate(
        [convolve(image[..., k : k + 1], weights[..., k : k + 1], stride, SAME) for k in range(3)], axis=-1
    )
    np.testing.assert_allclose(run(graph, image), expected, atol=1e-4)


@pytest.mark.parametrize(("activation", "bounds"), [(NONE, (-np.inf, np.inf)), (RELU, (0, np.inf)), (RELU6, (0, 6))])
@pytest.mark.parametrize(("kind", "function"), [("ADD", np.add), ("SUB", np.subtract), ("MUL", np.multiply)])
@pytest.mark.parametrize("shape", [(), (3,), (1, 1, 1, 3)])
def test_arithmetic_with_constant(
    kind: str, function: np.ufunc, shape: tuple[int, ...], activation: int, bounds: tuple[float, float]
) -> None:
    image = RANDOM.normal(scale=9, size=(4, 5, 3))
    constant = RANDOM.normal(size=shape).astype(np.float32)
    graph = graph_of(kind, [np.asarray(constant)], 3, options(FusedActivationFunction=activation))
    expected = function(image, constant.reshape(-1)).clip(*bounds)
    np.testing.assert_allclose(run(graph, image), expected, atol=1e-5)


def test_sigmoid() -> None:
    image = RANDOM.normal(size=(4, 5, 3))
    np.testing.assert_allclose(run(graph_of("LOGISTIC", [], 3, None), image), 1 / (1 + np.exp(-image)), atol=1e-6)


def resize_graph(half_pixel_centers: bool, size_from: str) -> Graph:
    tensors = (
        Tensor("image", (1, 1, 1, 3), None),
        Tensor("size", (2,), None),
        Tensor("factors", (2,), np.array([2, 2], np.int32)),
        Tensor("new_size", (2,), None),
        Tensor("result", (1, 1, 1, 3), None),
    )
    resize = Operator("RESIZE_BILINEAR", (0, 3), (4,), options(HalfPixelCenters=half_pixel_centers))
    return Graph(tensors, (Operator("SHAPE", (0,), (1,), None), Operator(size_from, (1, 2), (3,), None), resize))


def test_doubling() -> None:
    image = np.stack([np.tile(np.arange(4.0), (3, 1))] * 3, axis=-1)
    row = [0, 0.25, 0.75, 1.25, 1.75, 2.25, 2.75, 3]
    expected = np.tile(np.array(row)[None, :, None], (6, 1, 3))
    np.testing.assert_allclose(run(resize_graph(True, "MUL"), image), expected, atol=1e-6)


@pytest.mark.parametrize("arguments", [(False, "MUL"), (True, "PACK")])
def test_another_way_of_resizing_is_refused(arguments: tuple[bool, str]) -> None:
    with pytest.raises(ModelError, match="resizes in a way that is not supported"):
        convert_graph(resize_graph(*arguments), {"image": "input"}, {"result": "output"})


def fixed_graph(
    kind: str, shapes: tuple[tuple[int, ...], tuple[int, ...]], constants: Sequence[np.ndarray], operator_options: Any
) -> Graph:
    """Graph of a single operator whose input and output have the shapes (1, ...)."""
    tensors = [Tensor("image", shapes[0], None)]
    tensors += [Tensor(f"constant{k}", value.shape, value) for k, value in enumerate(constants)]
    tensors.append(Tensor("result", shapes[1], None))
    inputs = tuple(range(len(tensors) - 1))
    return Graph(tuple(tensors), (Operator(kind, inputs, (len(tensors) - 1,), operator_options),))


def run_fixed(graph: Graph, batch: np.ndarray) -> np.ndarray:
    """Result of a graph of fixed shapes for a batch; both are NHWC where they have four axes."""
    model = convert_graph(graph, {"image": "input"}, {"result": "output"}, is_fixed=True)
    session = onnxruntime.InferenceSession(model, providers=["CPUExecutionProvider"])
    source = batch.transpose(0, 3, 1, 2) if batch.ndim == 4 else batch
    assert session.get_inputs()[0].shape[1:] == list(source.shape[1:])
    (result,) = session.run(["output"], {"input": source.astype(np.float32)})
    assert session.get_outputs()[0].shape[1:] == list(np.shape(result)[1:])
    result = np.asarray(result)
    return result.transpose(0, 2, 3, 1) if result.ndim == 4 else result


def test_resizing_to_constant_size() -> None:
    row = np.arange(4.0)
    image = np.tile(row[None, None, :, None], (1, 3, 1, 2))
    graph = fixed_graph(
        "RESIZE_BILINEAR", ((1, 3, 4, 2), (1, 3, 8, 2)), [np.array([3, 8], np.int32)], options(HalfPixelCenters=True)
    )
    expected = np.array([0, 0.25, 0.75, 1.25, 1.75, 2.25, 2.75, 3])
    np.testing.assert_allclose(run_fixed(graph, image), np.tile(expected[None, None, :, None], (1, 3, 1, 2)), atol=1e-6)


@pytest.mark.parametrize("paddings", [[[0, 0], [1, 2], [3, 4], [0, 0]], [[0, 0], [0, 0], [0, 0], [1, 5]]])
def test_padding_of_rows_columns_and_channels(paddings: list[list[int]]) -> None:
    batch = RANDOM.normal(size=(2, 4, 5, 3))
    expected = np.pad(batch, paddings)
    graph = fixed_graph("PAD", ((1, *batch.shape[1:]), (1, *expected.shape[1:])), [np.array(paddings, np.int32)], None)
    np.testing.assert_allclose(run_fixed(graph, batch), expected, atol=1e-6)


@pytest.mark.parametrize(
    ("paddings", "kinds"),
    [([[0, 0], [1, 2], [0, 1], [0, 0]], ["Conv"]), ([[0, 0], [0, 1], [1, 0], [0, 2]], ["Pad", "Conv"])],
)
def test_padding_before_convolution_becomes_its_own(paddings: list[list[int]], kinds: list[str]) -> None:
    image = RANDOM.normal(size=(4, 5, 3))
    padded = np.pad(image, paddings[1:])
    weights = RANDOM.normal(size=(2, 3, 3, padded.shape[-1])).astype(np.float32)
    tensors = (
        Tensor("image", (1, 1, 1, 3), None),
        Tensor("paddings", (4, 2), np.array(paddings, np.int32)),
        Tensor("padded", (1, 1, 1, padded.shape[-1]), None),
        Tensor("weights", weights.shape, weights),
        Tensor("result", (1, 1, 1, 2), None),
    )
    operators = (
        Operator("PAD", (0, 1), (2,), None),
        Operator("CONV_2D", (2, 3, -1), (4,), convolution_options(2, VALID)),
    )
    graph = Graph(tensors, operators)
    np.testing.assert_allclose(run(graph, image), convolve(padded, weights, 2, VALID), atol=1e-5)
    model = onnx.load_model_from_string(convert_graph(graph, {"image": "input"}, {"result": "output"}))
    assert [node.op_type for node in model.graph.node][:-1] == kinds


@pytest.mark.parametrize("size", [6, 7])
def test_maxima(size: int) -> None:
    batch = RANDOM.normal(size=(2, size, size, 3))
    half = -(-size // 2)
    pool = options(FilterHeight=2, FilterWidth=2, StrideH=2, StrideW=2, Padding=SAME, FusedActivationFunction=RELU)
    graph = fixed_graph("MAX_POOL_2D", ((1, size, size, 3), (1, half, half, 3)), [], pool)
    # The odd row and column at the end are alone.
    cells = [[batch[:, 2 * y : 2 * y + 2, 2 * x : 2 * x + 2].max((1, 2)) for x in range(half)] for y in range(half)]
    expected = np.moveaxis(np.array(cells), 2, 0).clip(0)
    np.testing.assert_allclose(run_fixed(graph, batch), expected, atol=1e-6)


@pytest.mark.parametrize("keeps", [False, True])
def test_mean_of_rows_and_columns(keeps: bool) -> None:
    batch = RANDOM.normal(size=(2, 4, 5, 3))
    expected = batch.mean((1, 2), keepdims=keeps)
    shapes = ((1, 4, 5, 3), (1, *expected.shape[1:]))
    graph = fixed_graph("MEAN", shapes, [np.array([1, 2], np.int32)], options(KeepDims=keeps))
    np.testing.assert_allclose(run_fixed(graph, batch), expected, atol=1e-6)


def test_means_of_other_axes_are_refused() -> None:
    graph = fixed_graph("MEAN", ((1, 4, 5, 3), (1, 4, 5)), [np.array([3], np.int32)], options(KeepDims=False))
    with pytest.raises(ModelError, match="averages other axes than rows and columns"):
        run_fixed(graph, np.zeros((1, 4, 5, 3)))


def test_product_with_matrix() -> None:
    batch, weights = RANDOM.normal(size=(2, 6)), RANDOM.normal(size=(4, 6)).astype(np.float32)
    bias = RANDOM.normal(size=4).astype(np.float32)
    activation = options(FusedActivationFunction=RELU)
    graph = fixed_graph("FULLY_CONNECTED", ((1, 6), (1, 4)), [weights, bias], activation)
    np.testing.assert_allclose(run_fixed(graph, batch), (batch @ weights.T + bias).clip(0), atol=1e-5)
    without_bias = fixed_graph("FULLY_CONNECTED", ((1, 6), (1, 4)), [weights], options(FusedActivationFunction=NONE))
    np.testing.assert_allclose(run_fixed(without_bias, batch), batch @ weights.T, atol=1e-5)


def test_product_of_map_is_refused() -> None:
    weights = np.ones((4, 3), np.float32)
    graph = fixed_graph("FULLY_CONNECTED", ((1, 5, 5, 3), (1, 4)), [weights], options(FusedActivationFunction=NONE))
    with pytest.raises(ModelError, match="multiplies maps with a matrix"):
        run_fixed(graph, np.zeros((1, 5, 5, 3)))


def test_reshaping_keeps_order_of_channels_last() -> None:
    batch = RANDOM.normal(size=(3, 2, 4, 5))
    graph = fixed_graph("RESHAPE", ((1, 2, 4, 5), (1, 40)), [np.array([1, 40], np.int32)], None)
    np.testing.assert_allclose(run_fixed(graph, batch), batch.reshape(3, 40), atol=1e-6)


@pytest.mark.parametrize("shapes", [((1, 40), (1, 2, 20)), ((1, 2, 4, 5), (1, 4, 2, 5)), ((1, 2, 4, 5), (2, 20))])
def test_another_way_of_reshaping_is_refused(shapes: tuple[tuple[int, ...], tuple[int, ...]]) -> None:
    graph = fixed_graph("RESHAPE", shapes, [], None)
    with pytest.raises(ModelError, match="reshapes in a way that is not supported"):
        convert_graph(graph, {"image": "input"}, {"result": "output"}, is_fixed=True)


def test_unknown_operator_is_named() -> None:
    with pytest.raises(ModelError, match="needs FLOOR_DIV, which is not supported"):
        convert_graph(graph_of("FLOOR_DIV", [], 3, None), {"image": "input"}, {"result": "output"})


def test_unknown_activation_is_refused() -> None:
    graph = graph_of("ADD", [np.ones(3, np.float32)], 3, options(FusedActivationFunction=TANH))
    with pytest.raises(ModelError, match="needs activation 4, which is not supported"):
        convert_graph(graph, {"image": "input"}, {"result": "output"})


def test_dilation_is_refused() -> None:
    graph = graph_of("CONV_2D", [np.ones((3, 3, 3, 3), np.float32)], 3, convolution_options(1, SAME, dilation=2))
    with pytest.raises(ModelError, match="dilated convolution"):
        convert_graph(graph, {"image": "input"}, {"result": "output"})


def test_depth_multiplier_is_refused() -> None:
    wide = convolution_options(1, SAME)
    wide.DepthMultiplier = lambda: 2
    graph = graph_of("DEPTHWISE_CONV_2D", [np.ones((1, 3, 3, 6), np.float32)], 6, wide)
    with pytest.raises(ModelError, match="depth multiplier"):
        convert_graph(graph, {"image": "input"}, {"result": "output"})


def test_weights_that_depend_on_input_are_refused() -> None:
    graph = graph_of("CONV_2D", [], 3, convolution_options(1, SAME))
    (convolution,) = graph.operators
    two_inputs = Operator(convolution.kind, (0, 0), convolution.outputs, convolution.options)
    with pytest.raises(ModelError, match="weights of a kind that is not supported"):
        convert_graph(Graph(graph.tensors, (two_inputs,)), {"image": "input"}, {"result": "output"})


def test_missing_tensor_is_named() -> None:
    with pytest.raises(ModelError, match="has no tensor heatmap: it is not the version that is needed"):
        convert_graph(graph_of("LOGISTIC", [], 3, None), {"image": "input"}, {"heatmap": "heatmap"})


def test_extrapolation_has_no_support() -> None:
    graph = graph_of("LOGISTIC", [], 3, None)
    with pytest.raises(ModelError, match="a tensor that nothing makes"):
        convert_graph(graph, {}, {"result": "output"})


@pytest.mark.parametrize("content", [b"", b"no flatbuffer at all", bytes(1000), b"\xff" * 1000])
def test_no_model_is_reported(content: bytes) -> None:
    with pytest.raises(ModelError, match="damaged or has another format"):
        read_model(content)
