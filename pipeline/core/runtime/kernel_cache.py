"""Cache folder of the compiled kernels, and a check of its completeness.

The module imports neither numba nor NumPy, so that programs that must not load them can use it; the check takes
milliseconds.
"""

import functools
import hashlib
import importlib.metadata
import os
import platform
import sys
from pathlib import Path

from pipeline.core.runtime.packages.storage import home

_PIPELINE = Path(__file__).parents[2]
# All modules beside kernels are included: their constants are compiled into the kernels.
_FOLDERS = sorted({path.parent for path in _PIPELINE.rglob("*kernels.py")})
_SOURCES = [
    Path(__file__).with_name("jit.py"),
    *(path for folder in (_PIPELINE / "core" / "data", *_FOLDERS) for path in sorted(folder.glob("*.py"))),
]
_CPU_INFO = Path("/proc/cpuinfo")


@functools.cache
def cache_folder() -> Path | None:
    """Folder of compiled code; ``None`` if the folder can't be written, so that each process compiles by itself."""
    digest = hashlib.sha256(b"".join(path.read_bytes() for path in _SOURCES)).hexdigest()[:16]
    folder = home() / "kernels" / digest
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    return folder if os.access(folder, os.W_OK) else None


def is_complete() -> bool:
    """Return whether a warm-up has compiled all kernels of this installation for this processor."""
    folder = cache_folder()
    return folder is not None and _stamp(folder).is_file()


def note_complete() -> None:
    """Record that all kernels have been compiled."""
    if (folder := cache_folder()) is not None:
        _stamp(folder).touch()


def _stamp(folder: Path) -> Path:
    """File that marks a complete cache; its name is a digest of everything but the sources that code depends on.

    Numba separates cached code by the folder of its source, by Python's version and by the processor, and discards code
    of another version of numba.
    """
    versions = [importlib.metadata.version(name) for name in ("numba", "llvmlite")]
    warm_up = hashlib.sha256((_PIPELINE / "run" / "warm_up.py").read_bytes()).hexdigest()
    parts = [warm_up, str(_PIPELINE), sys.implementation.cache_tag, *versions, _processor()]
    return folder / f"complete-{hashlib.sha256(repr(parts).encode()).hexdigest()[:16]}"


def _processor() -> str:
    """Model and features of the processor, as reported by the system."""
    try:
        lines = _CPU_INFO.read_text().partition("\n\n")[0].splitlines()
    except OSError:
        return f"{platform.machine()} {platform.processor()}"
    return "".join(line for line in lines if line.startswith(("model name", "flags", "CPU part", "Features")))
