"""The execution provider of this process: the one that was chosen, if it works here, else the CPU, with the reason."""

import functools
import json
import subprocess
from importlib.metadata import PackageNotFoundError, version

from pipeline.core.options import providers
from pipeline.core.runtime.child_processes import module_command

# The first start of a driver takes some seconds.
_PROBE_S = 120.0


@functools.cache
def current_provider() -> providers.Provider:
    """Provider of this process, which is looked for once, or was found by its parent; see ``find_provider``.

    Raises ``PipelineError`` if ``MULTICAP_PROVIDER`` is no provider.
    """
    found = providers.handed_provider()
    if found is None:
        found = find_provider(providers.chosen_provider())
        providers.hand_on(found)
    return found


def find_provider(choice: providers.ProviderChoice) -> providers.Provider:
    """Find the provider for a choice; the CPU, with a note that says why, if the chosen one does not work here.

    ``auto`` is CUDA where its package is installed and it works, else the CPU: OpenVINO in single precision is no
    quicker than ONNX Runtime's own kernels, see docs/lab/operations-notes.md.
    """
    if choice == "cpu" or (choice == "auto" and _installed_version("cuda") is None):
        return providers.CPU
    return _probed("cuda" if choice == "auto" else choice)


def _probed(name: providers.ProviderName) -> providers.Provider:
    package, found = providers.PACKAGES[name], _installed_version(name)
    if found is None:
        remedy = f"pip install 'multicap[{package.extra}]'" if package.extra else "it is part of ONNX Runtime for macOS"
        return _fallback(name, f"the package {package.distribution} is not installed ({remedy})")
    try:
        told = json.loads(_probe(name))
    except subprocess.TimeoutExpired:
        return _fallback(name, f"it did not answer within {_PROBE_S:.0f} seconds")
    except ValueError:
        return _fallback(name, "a network on it ended the process")
    if "problem" in told:
        return _fallback(name, told["problem"] + _clash(name))
    return providers.Provider(name, found, told["device"])


def _probe(name: providers.ProviderName) -> bytes:
    command = module_command("pipeline.detection.profiles.probe", name)
    return subprocess.run(command, capture_output=True, timeout=_PROBE_S, check=False).stdout  # noqa: S603 (our module)


def _fallback(name: providers.ProviderName, reason: str) -> providers.Provider:
    return providers.Provider(note=f"Networks run on the CPU, not by {name}: {reason.rstrip('.')}.")


def _clash(name: providers.ProviderName) -> str:
    """Remedy for two distributions of ONNX Runtime, of which the later one has overwritten files of the earlier."""
    if providers.PACKAGES[name].distribution == "onnxruntime-gpu" and _installed("onnxruntime") is not None:
        return ". If it was installed beside onnxruntime: pip install --force-reinstall --no-deps onnxruntime-gpu"
    return ""


def _installed_version(name: providers.ProviderName) -> str | None:
    return _installed(providers.PACKAGES[name].distribution)


def _installed(distribution: str) -> str | None:
    try:
        return version(distribution)
    except PackageNotFoundError:
        return None
