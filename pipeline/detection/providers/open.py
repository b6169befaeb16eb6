"""ONNX Runtime sessions on an execution provider, in single precision and with reproducible outputs."""

import contextlib
import functools
import json
from importlib import import_module
from pathlib import Path
from typing import Any

import onnxruntime

from pipeline.core.options.providers import PACKAGES, ProviderName

# Outputs equal the CPU's: in the reduced precisions that providers choose by themselves (TF32 on NVIDIA's cards,
# bfloat16 on Intel's processors) landmarks are off by up to some pixels.
_OPENVINO = {"load_config": json.dumps({"CPU": {"INFERENCE_PRECISION_HINT": "f32", "INFERENCE_NUM_THREADS": 1}})}
_OPTIONS: dict[ProviderName, dict[str, str]] = {
    "cuda": {"use_tf32": "0", "cudnn_conv_algo_search": "HEURISTIC"},
    "tensorrt": {"trt_fp16_enable": "0", "trt_bf16_enable": "0"},
    "coreml": {"ModelFormat": "MLProgram", "AllowLowPrecisionAccumulationOnGPU": "0"},
}


def open_session(model: Path | bytes, name: ProviderName) -> onnxruntime.InferenceSession:
    """Open a model on a provider; raises ONNX Runtime's errors, or ``RuntimeError`` if the provider refuses.

    Each process uses one thread: several processes use the CPU better than several threads of a process, and results
    do not depend on the split of the work.
    """
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
    options.use_deterministic_compute = True
    options.log_severity_level = 3
    content = model if isinstance(model, bytes) else str(model)
    if name == "openvino":
        options.add_provider_for_devices([_openvino_device()], _OPENVINO)
        return onnxruntime.InferenceSession(content, options)
    providers: list[Any] = ["CPUExecutionProvider"]
    if name != "cpu":
        if PACKAGES[name].execution_provider not in onnxruntime.get_available_providers():
            raise RuntimeError("this package of ONNX Runtime does not have it")
        _load_libraries(name)
        providers.insert(0, (PACKAGES[name].execution_provider, _OPTIONS[name]))
    session = onnxruntime.InferenceSession(content, options, providers=providers)
    session.disable_fallback()
    if name != "cpu" and PACKAGES[name].execution_provider not in session.get_providers():
        raise RuntimeError("its libraries can't be loaded; install its driver, CUDA and cuDNN")
    return session


def device_name(name: ProviderName) -> str:
    """Name of a provider's device, as ONNX Runtime tells it; empty if it tells none."""
    if name == "cpu":
        return ""
    if name == "openvino":
        return str(_openvino_device().ep_metadata.get("FULL_DEVICE_NAME", ""))
    with contextlib.suppress(AttributeError, RuntimeError):
        for device in onnxruntime.get_ep_devices():
            if device.ep_name == PACKAGES[name].execution_provider:
                return str(device.device.metadata.get("Description", ""))
    return ""


def _load_libraries(name: ProviderName) -> None:
    """Load CUDA and cuDNN from NVIDIA's packages for Python, if they are there; else the system's are taken."""
    if name in {"cuda", "tensorrt"}:
        onnxruntime.preload_dlls()


@functools.cache
def _openvino_device() -> Any:
    """Processor as a device of OpenVINO, whose library is registered at the first call."""
    package = import_module("onnxruntime_ep_openvino")
    onnxruntime.register_execution_provider_library("openvino", package.get_library_path())
    for device in onnxruntime.get_ep_devices():
        if device.ep_name == package.get_ep_name() and device.ep_metadata.get("ov_device") == "CPU":
            return device
    raise RuntimeError("OpenVINO finds no processor that it knows.")
