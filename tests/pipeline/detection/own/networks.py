"""Small ONNX networks of known outputs: they find the brightest column and row of an image."""

from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper


def _model(
    nodes: list[onnx.NodeProto], shape: tuple[int | str, ...], outputs: dict[str, int], constants: dict[str, np.ndarray]
) -> onnx.ModelProto:
    graph = helper.make_graph(
        nodes,
        "small",
        [helper.make_tensor_value_info("image", TensorProto.FLOAT, shape)],
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, [None] * rank) for name, rank in outputs.items()],
        [numpy_helper.from_array(value, name) for name, value in constants.items()],
    )
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)


def simcc(num_points: int = 17, size: tuple[int | str, int | str] = (192, 256), domain: str = "") -> onnx.ModelProto:
    """Bins as wide as a pixel: for each point the mean of columns and rows over the other axis and the colours."""
    nodes = [
        helper.make_node("ReduceMean", ["image"], ["columns"], axes=[1, 2], keepdims=0),
        helper.make_node("ReduceMean", ["image"], ["rows"], axes=[1, 3], keepdims=0),
        helper.make_node("Unsqueeze", ["columns", "axis"], ["one_x"]),
        helper.make_node("Unsqueeze", ["rows", "axis"], ["one_y"]),
        helper.make_node("Tile", ["one_x", "repeats"], ["simcc_x"]),
        helper.make_node("Tile", ["one_y", "repeats"], ["simcc_y"], domain=domain),
    ]
    constants = {"axis": np.array([1], np.int64), "repeats": np.array([1, num_points, 1], np.int64)}
    return _model(nodes, (1, 3, size[1], size[0]), {"simcc_x": 3, "simcc_y": 3}, constants)


def heatmaps(num_points: int = 17) -> onnx.ModelProto:
    """Mean of colours in cells of 4 x 4 pixels, for each point the same."""
    nodes = [
        helper.make_node("AveragePool", ["image"], ["cells"], kernel_shape=[4, 4], strides=[4, 4]),
        helper.make_node("ReduceMean", ["cells"], ["gray"], axes=[1], keepdims=1),
        helper.make_node("Tile", ["gray", "repeats"], ["heatmaps"]),
    ]
    return _model(
        nodes, ("batch", 3, 256, 192), {"heatmaps": 4}, {"repeats": np.array([1, num_points, 1, 1], np.int64)}
    )


def rtmo(boxes: np.ndarray, keypoints: np.ndarray, size_px: int = 640) -> onnx.ModelProto:
    """The same people in every image."""
    nodes = [
        helper.make_node("ReduceMean", ["image"], ["mean"], axes=[0, 1, 2, 3], keepdims=0),
        helper.make_node("Mul", ["mean", "zero"], ["nothing"]),
        helper.make_node("Add", ["boxes", "nothing"], ["dets"]),
        helper.make_node("Add", ["points", "nothing"], ["keypoints"]),
    ]
    constants = {
        "zero": np.array(0, np.float32),
        "boxes": boxes[None].astype(np.float32),
        "points": keypoints[None].astype(np.float32),
    }
    return _model(nodes, (1, 3, size_px, size_px), {"dets": 3, "keypoints": 4}, constants)


def endless() -> onnx.ModelProto:
    """Network with a loop that never ends."""
    body = helper.make_graph(
        [
            helper.make_node("Identity", ["go_in"], ["go_out"]),
            helper.make_node("Add", ["sum_in", "image"], ["sum_out"]),
        ],
        "body",
        [
            helper.make_tensor_value_info("turn", TensorProto.INT64, []),
            helper.make_tensor_value_info("go_in", TensorProto.BOOL, []),
            helper.make_tensor_value_info("sum_in", TensorProto.FLOAT, None),
        ],
        [
            helper.make_tensor_value_info("go_out", TensorProto.BOOL, []),
            helper.make_tensor_value_info("sum_out", TensorProto.FLOAT, None),
        ],
    )
    nodes = [helper.make_node("Loop", ["", "go", "image"], ["endless"], body=body)]
    return _model(nodes, (1, 3, 8, 8), {"endless": 4}, {"go": np.array(True)})


def write(model: onnx.ModelProto, path: Path) -> Path:
    """Write a network; return its path."""
    onnx.save(model, path)
    return path
