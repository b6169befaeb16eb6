from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper

from pipeline.detect.session import open_network
from pipeline.errors import ModelError


def write_network(path: Path) -> Path:
    """Network whose outputs are twice the image and its negative."""
    shape: list[str | int | None] = [1, 3, "height", "width"]
    values = [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name in ("image", "twice", "negative")]
    nodes = [helper.make_node("Add", ["image", "image"], ["twice"]), helper.make_node("Neg", ["image"], ["negative"])]
    graph = helper.make_graph(nodes, "network", values[:1], values[1:])
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8), path)
    return path


def test_outputs_come_by_name(tmp_path: Path) -> None:
    image = np.arange(24, dtype=np.float32).reshape(1, 3, 2, 4)
    outputs = open_network(write_network(tmp_path / "net.onnx"))(image)
    np.testing.assert_array_equal(outputs["twice"], 2 * image)
    np.testing.assert_array_equal(outputs["negative"], -image)


@pytest.mark.parametrize("content", [b"", b"no network", b"\x08\x08\x12\x04test"])
def test_a_broken_file_is_said_without_its_path(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "net.onnx").write_bytes(content)
    with pytest.raises(ModelError, match=r"^net\.onnx is damaged") as caught:
        open_network(tmp_path / "net.onnx")
    assert str(tmp_path) not in str(caught.value)


def test_a_truncated_network_is_said(tmp_path: Path) -> None:
    path = write_network(tmp_path / "net.onnx")
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(ModelError, match=r"^net\.onnx is damaged"):
        open_network(path)
