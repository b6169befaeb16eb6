import importlib.metadata
import json
import subprocess
from collections.abc import Iterator

import pytest

from pipeline.core.errors import PipelineError
from pipeline.core.options.providers import CPU, Provider, ProviderChoice, choose_provider, provider_name
from pipeline.detection.providers import find
from pipeline.detection.providers.find import current_provider, find_provider


@pytest.fixture(autouse=True)
def fresh(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Nothing is chosen or found, and nothing stays."""
    for name in ("MULTICAP_PROVIDER", "MULTICAP_PROVIDER_FOUND"):
        monkeypatch.setenv(name, "")
        monkeypatch.delenv(name)
    current_provider.cache_clear()
    yield
    current_provider.cache_clear()


def install(monkeypatch: pytest.MonkeyPatch, **versions: str) -> None:
    """Say that these distributions are installed, and no other."""

    def version(name: str) -> str:
        key = name.replace("-", "_")
        if key not in versions:
            raise importlib.metadata.PackageNotFoundError(name)
        return versions[key]

    monkeypatch.setattr(find, "version", version)


def answer(monkeypatch: pytest.MonkeyPatch, stdout: bytes) -> list[list[str]]:
    """Let the probe answer something; returns the commands that were run."""
    commands = []

    def run(command: list[str], **_: object) -> subprocess.CompletedProcess[bytes]:
        commands.append(command)
        return subprocess.CompletedProcess(command, 0, stdout)

    monkeypatch.setattr(subprocess, "run", run)
    return commands


def test_auto_is_cpu_without_package_for_gpus(monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, onnxruntime="1", onnxruntime_ep_openvino="1")
    assert find_provider("auto") == CPU
    assert CPU.identity == ""


def test_auto_is_cuda_where_it_works(monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, onnxruntime_gpu="1.31.1")
    answer(monkeypatch, json.dumps({"device": "NVIDIA H200"}).encode())
    assert find_provider("auto") == Provider("cuda", "1.31.1", "NVIDIA H200")
    assert find_provider("auto").identity == "cuda 1.31.1"
    assert find_provider("cpu") == CPU


@pytest.mark.parametrize("choice", ["openvino", "cuda", "tensorrt"])
def test_missing_package_is_named_with_command_that_installs_it(
    choice: ProviderChoice, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(monkeypatch)
    found = find_provider(choice)
    assert found.name == "cpu"
    assert choice in found.note
    assert f"pip install 'multicap[{'openvino' if choice == 'openvino' else 'gpu'}]'" in found.note


def test_driver_that_fails_is_said_with_its_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, onnxruntime="1.31.1", onnxruntime_gpu="1.31.1")
    answer(monkeypatch, json.dumps({"problem": "no CUDA-capable device is detected"}).encode())
    found = find_provider("cuda")
    assert found.identity == ""
    assert "not by cuda: no CUDA-capable device is detected" in found.note
    assert "--force-reinstall" in found.note  # both distributions of ONNX Runtime are there


@pytest.mark.parametrize("stdout", [b"", b"{", b"Segmentation fault"])
def test_probe_that_crashes_leaves_cpu(stdout: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, onnxruntime_gpu="1.31.1")
    answer(monkeypatch, stdout)
    assert "ended the process" in find_provider("cuda").note


def test_probe_that_hangs_leaves_cpu(monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, onnxruntime_gpu="1.31.1")

    def run(command: list[str], timeout: float, **_: object) -> None:
        raise subprocess.TimeoutExpired(command, timeout)

    monkeypatch.setattr(subprocess, "run", run)
    assert "did not answer within 120 seconds" in find_provider("cuda").note


def test_environment_reaches_started_processes(monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, onnxruntime_gpu="1.31.1")
    commands = answer(monkeypatch, json.dumps({"device": "GPU"}).encode())
    choose_provider("cuda")
    assert current_provider().name == "cuda"
    current_provider.cache_clear()  # as a process has it that was started
    assert current_provider() == Provider("cuda", "1.31.1", "GPU")
    assert len(commands) == 1


def test_wrong_name_in_environment_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MULTICAP_PROVIDER", "gpu")
    with pytest.raises(PipelineError, match=r"MULTICAP_PROVIDER=gpu is not a provider; choose one of auto, cpu"):
        current_provider()


def test_coreml_is_refused_where_onnx_runtime_lacks_it() -> None:
    found = find_provider("coreml")
    assert found.name == "cpu"
    assert "does not have it" in found.note


def test_names_are_read_from_identities() -> None:
    assert provider_name("cuda 1.31.1") == "cuda"
    assert provider_name("") == provider_name("unknown 1") == "cpu"
