"""A quantized network gives nearly the outputs of the float network, and equal bytes each time."""

from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from pipeline.core.errors import ModelError
from pipeline.detection import models
from pipeline.detection.entries import find_entry
from pipeline.detection.network import open_network
from pipeline.detection.quantization.static_quantization import RANGES, end, quantize
from tests.pipeline.detection.quantization.measured_ranges import measure_ranges

RANDOM = np.random.default_rng(3)
IMAGES = [RANDOM.uniform(0.0, 1.0, (1, 3, 12, 16)).astype(np.float32) for _ in range(4)]


@pytest.fixture
def network() -> bytes:
    """Two convolutions with a clip between them, whose channels have very different weights."""
    first = RANDOM.normal(0.0, 1.0, (8, 3, 3, 3)) * np.geomspace(0.01, 1.0, 8)[:, None, None, None]
    second = RANDOM.normal(0.0, 1.0, (2, 8, 1, 1))
    constants = {"w1": first, "b1": np.full(8, 0.1), "w2": second, "b2": np.zeros(2), "zero": 0.0, "six": 6.0}
    nodes = [
        helper.make_node("Conv", ["image", "w1", "b1"], ["hidden"], pads=[1, 1, 1, 1]),
        helper.make_node("Clip", ["hidden", "zero", "six"], ["clipped"]),
        helper.make_node("Conv", ["clipped", "w2", "b2"], ["out"]),
    ]
    graph = helper.make_graph(
        nodes,
        "small",
        [helper.make_tensor_value_info("image", TensorProto.FLOAT, [1, 3, "height", "width"])],
        [helper.make_tensor_value_info("out", TensorProto.FLOAT, [1, 2, "height", "width"])],
        [numpy_helper.from_array(np.asarray(value, np.float32), name) for name, value in constants.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    content: bytes = model.SerializeToString()
    return content


def outputs(content: bytes, folder: Path) -> np.ndarray:
    path = folder / "network.onnx"
    path.write_bytes(content)
    run = open_network(path)
    return np.stack([run(image)["out"] for image in IMAGES])


def test_outputs_are_nearly_those_of_float_network(network: bytes, tmp_path: Path) -> None:
    quantized = quantize(network, measure_ranges(network, IMAGES))
    expected = outputs(network, tmp_path)
    error = outputs(quantized, tmp_path) - expected
    assert 0.0 < np.abs(error).max() < 0.03 * np.ptp(expected)


def test_sums_of_two_products_do_not_saturate(network: bytes) -> None:
    """Some processors add two products of an activation and a weight in 16 bits."""
    quantized = onnx.load_model_from_string(quantize(network, measure_ranges(network, IMAGES)))
    weights = {one.name: numpy_helper.to_array(one) for one in quantized.graph.initializer}
    for name in ("w1_quantized", "w2_quantized"):
        assert weights[name].dtype == np.int8
        # Each channel uses the whole range.
        greatest = np.abs(weights[name].astype(int)).reshape(len(weights[name]), -1).max(1)
        assert greatest.tolist() == [64] * len(greatest)
        assert 255 * 2 * greatest.max() < 2**15


def test_values_without_range_stay_in_floating_point(network: bytes) -> None:
    ranges = measure_ranges(network, IMAGES)
    del ranges["out"]
    names = {one.name for one in onnx.load_model_from_string(quantize(network, ranges)).graph.initializer}
    assert {"w2", "w1_quantized"} <= names
    assert "w2_quantized" not in names


def test_equal_ranges_give_equal_bytes(network: bytes) -> None:
    ranges = measure_ranges(network, IMAGES)
    first = quantize(network, ranges)
    # The last bits of the values differ from processor to processor.
    noisy = [(image * np.float32(1 + 1e-6)).astype(np.float32) for image in IMAGES]
    assert quantize(network, measure_ranges(network, noisy)) == first


def test_ranges_enclose_values(network: bytes) -> None:
    low, high = (end(one) for one in measure_ranges(network, IMAGES)["image"])
    greatest = max(float(image.max()) for image in IMAGES)
    assert low == 0.0
    assert greatest <= high < 2 ** (1 / 16) * greatest
    assert measure_ranges(network, [np.full((1, 3, 12, 16), -3.0, np.float32)])["image"] == (26, None)


def test_installed_network_is_made_from_float_network() -> None:
    try:
        content, made = (models.verify(name).read_bytes() for name in ("movenet-multipose", "movenet-multipose-int8"))
    except ModelError as error:
        pytest.skip(str(error))
    assert quantize(content, RANGES) == made
    assert len(made) == find_entry("movenet-multipose-int8").num_bytes
