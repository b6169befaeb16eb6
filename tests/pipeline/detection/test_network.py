from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper

from pipeline.core.errors import ModelError
from pipeline.core.options.providers import Provider, ProviderName
from pipeline.detection import detector, network
from pipeline.detection.network import one_by_one, open_network


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
def test_broken_file_is_said_without_its_path(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "net.onnx").write_bytes(content)
    with pytest.raises(ModelError, match=r"^net\.onnx is damaged") as caught:
        open_network(tmp_path / "net.onnx")
    assert str(tmp_path) not in str(caught.value)


def test_truncated_network_is_said(tmp_path: Path) -> None:
    path = write_network(tmp_path / "net.onnx")
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(ModelError, match=r"^net\.onnx is damaged"):
        open_network(path)


def test_batch_on_cpu_is_run_image_by_image() -> None:
    """The outputs of an image do not depend on the batch that it comes in."""
    sizes = []

    def run(image: np.ndarray) -> dict[str, np.ndarray]:
        sizes.append(len(image))
        return {"twice": 2 * image}

    batch = np.arange(48, dtype=np.float32).reshape(2, 3, 2, 4)
    np.testing.assert_array_equal(one_by_one(run)(batch)["twice"], 2 * batch)
    assert sizes == [1, 1]


def test_provider_that_can_not_run_network_leaves_it_to_cpu(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(network, "current_provider", lambda: Provider("cuda", "1"))
    image = np.ones((1, 3, 2, 4), np.float32)
    outputs = open_network(write_network(tmp_path / "net.onnx"))(image)
    np.testing.assert_array_equal(outputs["twice"], 2 * image)
    assert "The network net runs on the CPU, not by cuda" in caplog.text


def test_provider_with_other_outputs_leaves_network_to_cpu(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """A stand-in for a GPU: its network gives values that are off by a hundredth."""
    run_really = network._open

    def opened(path: Path, provider: ProviderName) -> network._Opened:
        real = run_really(path, "cpu")
        if provider == "cpu":
            return real
        return replace(real, run=lambda image: {name: 1.01 * values for name, values in real.run(image).items()})

    monkeypatch.setattr(network, "current_provider", lambda: Provider("cuda", "1"))
    monkeypatch.setattr(network, "_open", opened)
    image = np.ones((1, 3, 2, 4), np.float32)
    outputs = open_network(write_network(tmp_path / "net.onnx"))(image)
    np.testing.assert_array_equal(outputs["twice"], 2 * image)
    assert "differ from the CPU's by 0.01" in caplog.text


def test_gpus_run_twin_of_network_in_integers(monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[Path] = []
    monkeypatch.setattr(detector, "verify", Path)
    monkeypatch.setattr(detector, "open_network", opened.append)
    for provider in (Provider(), Provider("openvino", "1"), Provider("cuda", "1")):
        monkeypatch.setattr(detector, "current_provider", lambda provider=provider: provider)
        detector.open_detector("movenet-multipose-int8")
    assert [path.name for path in opened] == ["movenet-multipose-int8"] * 2 + ["movenet-multipose"]
