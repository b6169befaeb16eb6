"""Digest of the code behind each stage, with the versions of the numeric libraries; standard library only.

The digest is part of the keys of a stage's outputs: other code never finds the outputs of this one, and equal code
finds them whatever else has changed. It also says which workers can run a chunk.
"""

import contextlib
import functools
import hashlib
import json
import re
import tempfile
from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import MappingProxyType

from pipeline.core.runtime.code_digest import BY_MEMBER, PACKAGE, forget_sources, function_digest
from pipeline.core.runtime.packages.storage import home
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

_SHA256 = re.compile("[0-9a-f]{64}")
_ROOT = Path(__file__).parents[3]
# Code of all stages: what tasks ask, and the record of the session's check. Not imported here: it loads the science.
_RECORD = "pipeline.capture.preflight_npz"
_OF_ALL = (BY_MEMBER, "Context"), (_RECORD, "decode_session"), (_RECORD, "decode_keypoints")


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
    """Digests for networks on the CPU.

    They take seconds, and every process needs them: the first one keeps them in the folder of the installation.
    """
    file = home() / "stage-codes" / f"{sources_sha256()}.json"
    codes = _kept(file)
    if codes is None:
        codes = digests_of_stages()
        _keep(file, codes)
    return MappingProxyType(codes)


def digests_of_stages(root: Path = _ROOT, libraries: Sequence[str] = LIBRARIES) -> dict[str, str]:
    """Digest of the code of each stage in a folder of sources, and of the versions of libraries, in hexadecimal."""
    versions = [[name, _version(name)] for name in libraries]
    digests = {}
    for stage in STAGES:
        _, _, module = stage.function.__module__.rpartition(".")
        digests[stage.name] = function_digest(
            root, [(f"{PACKAGE}.run.steps.{module}", stage.function.__name__), *_OF_ALL]
        )
    forget_sources()
    return {stage: _hash([digest, versions]) for stage, digest in digests.items()}


def _hash(value: object) -> str:
    return hashlib.sha256(json.dumps(value).encode()).hexdigest()


def _kept(file: Path) -> dict[str, str] | None:
    """Digests that a process has kept; ``None`` if there are none or the file is damaged."""
    try:
        codes = json.loads(file.read_bytes())
    except (OSError, ValueError):
        return None
    is_whole = isinstance(codes, dict) and codes.keys() == {stage.name for stage in STAGES}
    return codes if is_whole and all(_SHA256.fullmatch(str(code)) for code in codes.values()) else None


def _keep(file: Path, codes: Mapping[str, str]) -> None:
    """Keep digests, whole or not at all; where the folder can't be written, each process computes them."""
    with contextlib.suppress(OSError):
        file.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile("w", dir=file.parent, prefix="new-", delete=False) as new:
            json.dump(codes, new)
        Path(new.name).replace(file)


def sources_sha256(root: Path = _ROOT, libraries: Sequence[str] = LIBRARIES) -> str:
    """SHA-256 of all sources of the pipeline and of the libraries' versions: equal for equal digests.

    It takes milliseconds.
    """
    sources = hashlib.sha256(repr([_version(name) for name in libraries]).encode())
    for path in sorted((root / PACKAGE).rglob("*.py")):
        sources.update(f"{path.relative_to(root)}\n".encode() + path.read_bytes())
    return sources.hexdigest()


def _version(distribution: str) -> str:
    # An API's machine may lack a library that its workers have; see `requirements.lock` for the versions of both.
    try:
        return version(distribution)
    except PackageNotFoundError:
        return ""
