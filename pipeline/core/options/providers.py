"""Names of the execution providers, the choice of one at start, and what was found; standard library only."""

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from types import MappingProxyType
from typing import Literal, get_args

from pipeline.core.errors import PipelineError

ProviderName = Literal["cpu", "openvino", "cuda", "tensorrt", "coreml"]
ProviderChoice = Literal["auto", "cpu", "openvino", "cuda", "tensorrt", "coreml"]

SETTING = "MULTICAP_PROVIDER"
"""Environment variable with the choice, for this process and its children."""
# Environment variable by which a process tells its children what it has found.
_FOUND = "MULTICAP_PROVIDER_FOUND"


@dataclass(frozen=True, slots=True)
class ProviderPackage:
    """Package of an execution provider."""

    execution_provider: str  # Name in ONNX Runtime
    distribution: str  # Distribution that brings it
    extra: str | None  # Extra of Multicap that installs it; ``None``: it comes with ONNX Runtime on its platform


PACKAGES: Mapping[ProviderName, ProviderPackage] = MappingProxyType(
    {
        "openvino": ProviderPackage("OpenVINOExecutionProvider", "onnxruntime-ep-openvino", "openvino"),
        "cuda": ProviderPackage("CUDAExecutionProvider", "onnxruntime-gpu", "gpu"),
        "tensorrt": ProviderPackage("TensorrtExecutionProvider", "onnxruntime-gpu", "gpu"),
        "coreml": ProviderPackage("CoreMLExecutionProvider", "onnxruntime", None),
    }
)
"""Packages of the providers beside the CPU's."""


@dataclass(frozen=True, slots=True)
class Provider:
    """An execution provider that was found on this machine."""

    name: ProviderName = "cpu"
    version: str = ""  # Version of its package; empty for the CPU's, which comes with the pinned ONNX Runtime
    device: str = ""  # Name of its device; empty if it tells none
    note: str = ""  # Sentence that says why it is not the one that was asked for; empty if it is

    @property
    def identity(self) -> str:
        """Text on which the outputs of the networks depend; empty for the CPU."""
        return "" if self.name == "cpu" else f"{self.name} {self.version}"

    @property
    def is_gpu(self) -> bool:
        """True if networks run on another processor than the CPU."""
        return self.name in {"cuda", "tensorrt", "coreml"}


CPU = Provider()


def provider_name(identity: str) -> ProviderName:
    """Name of a provider by its identity; the CPU's if it is empty or unknown."""
    name = identity.partition(" ")[0]
    return next((known for known in PACKAGES if known == name), "cpu")


def chosen_provider() -> ProviderChoice:
    """Choice of the environment; ``PipelineError`` if it is none of the names."""
    choice = os.environ.get(SETTING) or "auto"
    for name in get_args(ProviderChoice):
        if name == choice:
            return name
    names = ", ".join(get_args(ProviderChoice))
    raise PipelineError(f"{SETTING}={choice} is not a provider; choose one of {names}.")


def choose_provider(choice: ProviderChoice) -> None:
    """Choose the provider of this process, before it opens a network, and of its children."""
    os.environ[SETTING] = choice
    os.environ.pop(_FOUND, None)


def handed_provider() -> Provider | None:
    """Provider that the parent process has found; ``None`` if it has looked for none."""
    text = os.environ.get(_FOUND)
    return None if text is None else Provider(**json.loads(text))


def hand_on(provider: Provider) -> None:
    """Tell the processes that this one starts what was found: they need not look again."""
    os.environ[_FOUND] = json.dumps(asdict(provider))
