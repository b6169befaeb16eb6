"""Digest of the code behind each stage, with the versions of the numeric libraries; standard library only.

The digest is part of the keys of a stage's outputs: other code never finds the outputs of this one, and equal code
finds them whatever else has changed. It also says which workers can run a chunk.
"""

import functools
import hashlib
import json
from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import MappingProxyType

from pipeline.runtime.code_digest import BY_MEMBER, PACKAGE, forget_sources, function_digest
from pipeline.stages.plan import STAGES

LIBRARIES = (
    "av",
    "ezc3d",
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

_ROOT = Path(__file__).parents[2]
# Code of all stages: what tasks ask, and the record of the session's check. Not imported here: it loads the science.
_RECORD = "pipeline.capture.preflight_npz"
_OF_ALL = (BY_MEMBER, "Context"), (_RECORD, "decode_session"), (_RECORD, "decode_keypoints")


@functools.cache
def stage_codes(root: Path = _ROOT, libraries: Sequence[str] = LIBRARIES) -> Mapping[str, str]:
    """Digest of the code of each stage, by name of the stage.

    It takes about a second, once a process. ``root`` is the folder of the packages' sources; the versions of
    ``libraries``, installed distributions, count. Digests are SHA-256 in hexadecimal digits.
    """
    versions = [[name, _version(name)] for name in libraries]
    digests = {}
    for stage in STAGES:
        _, _, module = stage.function.__module__.rpartition(".")
        digests[stage.name] = function_digest(root, [(f"{PACKAGE}.stages.{module}", stage.function.__name__), *_OF_ALL])
    forget_sources()
    return MappingProxyType(
        {
            stage: hashlib.sha256(json.dumps([digest, versions]).encode()).hexdigest()
            for stage, digest in digests.items()
        }
    )


def sources_sha256(root: Path = _ROOT, libraries: Sequence[str] = LIBRARIES) -> str:
    """SHA-256 of all sources of the pipeline and of the libraries' versions: equal for equal ``stage_codes``.

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
