"""Digest of the code behind each stage, with the versions of the numeric libraries; standard library only.

The digest is part of the keys of a stage's outputs: different code never finds outputs of an earlier version, and equal
code finds them again. It also says which workers can run a chunk. The digest of a stage covers the files of all modules
that its module imports or runs as child processes, directly or indirectly, also inside functions. A checkout and an
installed wheel have equal digests.
"""

import functools
import hashlib
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import MappingProxyType

from pipeline.run.engine.plan import STAGES

LIBRARIES = (
    "av",
    "llvmlite",
    "numba",
    "numpy",
    "onnx",
    "onnxruntime",
    "opencv-python-headless",
    "pygltflib",
    "scikit-learn",
    "scipy",
    "tflite",
)
"""Distributions whose versions results may depend on."""

_ROOT = Path(__file__).parents[3]
_PACKAGE = "pipeline"
# Module behind every stage, which executors use: the record of an opened session.
_OF_ALL = "pipeline.capture.preflight_npz"
# Module that loads all modules of a package by name.
_LOADING, _LOADED = "pipeline.export.writers.registry", "pipeline.export.writers."
# The wheel's build puts this prefix before names of the packages. See `hatch_build.py`.
_WHEEL_PREFIX = re.compile(rb"\bmulticap\.(?=(?:api|pipeline|worker)\b)")
_FOR_TYPE_CHECKERS = re.compile(rb"^if TYPE_CHECKING:\n(?:[ \t].*\n|\n)*", re.MULTILINE)
# Module that runs as a child process.
_CHILD = re.compile(r"(?:run_confined|module_command)\(\s*\"(pipeline(?:\.\w+)+)\"")
_IMPORT = re.compile(r"^[ \t]*from (pipeline(?:\.\w+)*) import (\([\s\S]*?^[ \t]*\)|.*)", re.MULTILINE)


def stage_codes(provider: str = "") -> Mapping[str, str]:
    """Digest of the code of each stage of this installation, by name of the stage.

    ``provider`` is the identity of the execution provider of the networks, see
    ``pipeline.core.options.providers.Provider``: stages that run networks have other outputs with another one, so that
    no worker runs the chunks of a plan that was made for another provider.
    """
    codes = _codes_on_cpu()
    if not provider:
        return codes
    of_provider = {stage.name for stage in STAGES if stage.runs_networks}
    return MappingProxyType(
        {name: _hash([code, provider]) if name in of_provider else code for name, code in codes.items()}
    )


@functools.cache
def _codes_on_cpu() -> Mapping[str, str]:
    return MappingProxyType(digests_of_stages())


def digests_of_stages(root: Path = _ROOT, libraries: Sequence[str] = LIBRARIES) -> dict[str, str]:
    """Digest of the code of each stage in a folder of sources, and of the versions of libraries, in hexadecimal."""
    versions = [[name, _version(name)] for name in libraries]
    sources = SourceFolder(root)
    digests = {}
    for stage in STAGES:
        _, _, module = stage.function.__module__.rpartition(".")
        reached = sources.reachable_modules([f"{_PACKAGE}.run.steps.{module}", _OF_ALL])
        digests[stage.name] = _hash([[[name, sources.sha256(name)] for name in reached], versions])
    return digests


class SourceFolder:
    """Modules of the pipeline in a folder of sources, each read once."""

    def __init__(self, root: Path) -> None:
        self._files: dict[str, Path] = {}
        for path in (root / _PACKAGE).rglob("*.py"):
            parts = path.relative_to(root).with_suffix("").parts
            self._files[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
        self._modules: dict[str, tuple[str, frozenset[str]]] = {}

    def reachable_modules(self, modules: Iterable[str]) -> list[str]:
        """List modules and the modules that they import or run, directly or indirectly, with packages, by name."""
        reached: set[str] = set()
        waiting = set(modules)
        while waiting:
            name = waiting.pop()
            reached.add(name)
            waiting |= self._module(name)[1] - reached
        return sorted(reached)

    def sha256(self, module: str) -> str:
        """SHA-256 of a module's text as in a checkout, in hexadecimal digits."""
        return self._module(module)[0]

    def _module(self, name: str) -> tuple[str, frozenset[str]]:
        if name not in self._modules:
            source = _WHEEL_PREFIX.sub(b"", self._files[name].read_bytes())
            text = _FOR_TYPE_CHECKERS.sub(b"", source).decode()
            origins = set(_CHILD.findall(text))
            for module, names in _IMPORT.findall(text):
                origins |= {module, *(f"{module}.{word}" for word in re.findall(r"\w+", names))}
            if name == _LOADING:
                origins |= {module for module in self._files if module.startswith(_LOADED)}
            split = [origin.split(".") for origin in (name, *origins)]
            prefixes = {".".join(parts[:length]) for parts in split for length in range(1, len(parts) + 1)}
            self._modules[name] = hashlib.sha256(source).hexdigest(), frozenset(prefixes & self._files.keys())
        return self._modules[name]


def _hash(value: object) -> str:
    return hashlib.sha256(json.dumps(value).encode()).hexdigest()


def _version(distribution: str) -> str:
    # An API's machine may lack a library that its workers have; see `requirements.lock` for the versions of both.
    try:
        return version(distribution)
    except PackageNotFoundError:
        return ""
