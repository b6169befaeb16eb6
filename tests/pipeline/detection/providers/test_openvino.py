"""The networks on OpenVINO, as a user has it: a package beside ONNX Runtime, registered at run time."""

import importlib.util
import logging
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from pipeline.core.options.providers import CPU, choose_provider
from pipeline.detection.models import installed_path, status
from pipeline.detection.network import noise, open_network
from pipeline.detection.providers.find import current_provider, find_provider

pytestmark = [
    pytest.mark.skipif(
        importlib.util.find_spec("onnxruntime_ep_openvino") is None, reason="OpenVINO has no package for this machine."
    ),
    pytest.mark.skipif(
        "GenuineIntel" not in Path("/proc/cpuinfo").read_text(encoding="utf-8"),
        reason="OpenVINO's plugin takes Intel's processors alone.",
    ),
]


@pytest.fixture
def by_openvino(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    for name in ("MULTICAP_PROVIDER", "MULTICAP_PROVIDER_FOUND"):
        monkeypatch.setenv(name, "")
        monkeypatch.delenv(name)
    current_provider.cache_clear()
    choose_provider("openvino")
    yield
    current_provider.cache_clear()


def test_it_is_found_by_probe_in_process_of_its_own() -> None:
    found = find_provider("openvino")
    assert (found.name, found.note) == ("openvino", "")
    assert found.version
    assert found.device


@pytest.mark.usefixtures("by_openvino")
def test_network_in_single_precision_equals_cpu(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    path, picture = _installed("mediapipe-hand"), noise((224, 224))
    with caplog.at_level(logging.WARNING):
        found = open_network(path)(picture)
    assert not caplog.records
    monkeypatch.setattr("pipeline.detection.network.current_provider", lambda: CPU)
    for name, values in open_network(path)(picture).items():
        np.testing.assert_allclose(found[name], values, atol=1e-3 * np.abs(values).max())


@pytest.mark.usefixtures("by_openvino")
def test_batch_has_outputs_of_its_images() -> None:
    network = open_network(_installed("mediapipe-hand"))
    pictures = [noise((224, 224), seed) for seed in range(3)]
    together = network(np.concatenate(pictures))
    for number, picture in enumerate(pictures):
        for name, values in network(picture).items():
            np.testing.assert_allclose(together[name][number : number + 1], values, atol=1e-3)


@pytest.mark.usefixtures("by_openvino")
def test_network_in_integers_stays_on_cpu_with_warning(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    path, picture = _installed("movenet-multipose-int8"), noise((256, 256)) * np.float32(255)
    with caplog.at_level(logging.WARNING):
        found = open_network(path)(picture)
    (record,) = caplog.records
    assert "movenet-multipose-int8 runs on the CPU, not by openvino: its outputs differ" in record.getMessage()
    monkeypatch.setattr("pipeline.detection.network.current_provider", lambda: CPU)
    for name, values in open_network(path)(picture).items():
        np.testing.assert_array_equal(found[name], values)


def _installed(name: str) -> Path:
    if name not in {network.name for network in status() if network.installed}:
        pytest.skip(f"The network {name} is not installed.")
    return installed_path(name)
