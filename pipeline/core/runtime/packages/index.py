"""Search and download of a pinned package's file with pip's settings, without a build or run of the package."""

import ast
import hashlib
import importlib.util
import logging
import re
import ssl
import subprocess
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal, cast

from pipeline.core.errors import ModelError
from pipeline.core.runtime.child_processes import python_command
from pipeline.core.runtime.packages.download import OnBytes, download, silent
from pipeline.core.runtime.packages.storage import file_sha256, home

# Slow to load, and needed for downloads alone: the API and the workers start without it.
if TYPE_CHECKING:
    from unearth import Link, PackageFinder
    from unearth.fetchers import Fetcher, PyPIClient

_TIMEOUT_S = 30.0
# Without a handler, Python prints the finder's messages, which contain the indexes' addresses, to stderr.
logging.getLogger("unearth").addHandler(logging.NullHandler())


@dataclass(frozen=True, slots=True)
class PinnedFile:
    """File of one version of a package: a wheel or a source archive."""

    # Name and version of the package, as in ``name==version``
    name: str
    version: str
    filename: str  # Name of the file on the index
    # Checksum and size of the file
    sha256: str
    num_bytes: int
    index: Literal["pip", "npm"] = "pip"  # Kind of the index that has the package: pip's or npm's

    def __str__(self) -> str:
        return f"{self.name}=={self.version}"


@dataclass(frozen=True, slots=True)
class PipSettings:
    """Settings of pip, from its files and the environment, for the search of packages."""

    index_url: str | None = None  # URL of the index; ``None`` for the default index
    # See pip's options of these names
    extra_index_urls: tuple[str, ...] = ()
    find_links: tuple[str, ...] = ()
    trusted_hosts: tuple[str, ...] = ()
    no_index: bool = False  # True if only ``find_links`` is searched
    ca_file: str | None = None  # File of trusted certificates; ``None`` for the system's certificates
    proxy: str | None = None  # URL of the proxy; ``None`` for the environment's


def fetch_package(pinned: PinnedFile, on_bytes: OnBytes = silent, settings: PipSettings | None = None) -> Path:
    """Find and download a package's file, unless it is in ``downloads/``; return its path.

    ``settings`` are pip's by default. Raises ``ModelError`` if an index can't be reached, no index has the file, or the
    download fails, see ``download``.
    """
    target = downloads() / pinned.filename
    if target.is_file() and file_sha256(target) == pinned.sha256:
        return target
    settings = pip_settings() if settings is None else settings
    with open_client(settings) as client:
        link = _find(client, settings, pinned)
        return download(client, link.url_without_fragment, target, {pinned.sha256}, pinned.num_bytes, on_bytes)


def fetch_url(url: str, sha256: Collection[str], max_bytes: int, on_bytes: OnBytes = silent) -> Path:
    """Download a file from a URL into ``downloads/``; return its path. See ``download``."""
    from unearth import Link  # noqa: PLC0415

    target = downloads() / hashlib.sha256(url.encode()).hexdigest()[:16] / (Link(url).filename or "file")
    with open_client(pip_settings()) as client:
        return download(client, url, target, sha256, max_bytes, on_bytes)


def downloads() -> Path:
    """Folder of downloaded packages."""
    return home() / "downloads"


def pip_settings() -> PipSettings:
    """Read the settings of ``pip download``; the default settings if pip is not installed.

    Raises ``ModelError`` if pip fails to list its settings.
    """
    options = _pip_options()
    return PipSettings(
        index_url=options.get("index-url"),
        extra_index_urls=tuple(options.get("extra-index-url", "").split()),
        find_links=tuple(options.get("find-links", "").split()),
        trusted_hosts=tuple(options.get("trusted-host", "").split()),
        no_index=options.get("no-index", "").lower() in {"1", "true", "yes", "on"},
        ca_file=options.get("cert"),
        proxy=options.get("proxy"),
    )


def _pip_options() -> dict[str, str]:
    if importlib.util.find_spec("pip") is None:
        return {}
    command = python_command("-m", "pip", "--disable-pip-version-check", "config", "list")
    try:
        listing = subprocess.run(  # noqa: S603 (no part of the command is input)
            command, capture_output=True, text=True, check=True, timeout=_TIMEOUT_S
        ).stdout
    except (OSError, subprocess.SubprocessError) as error:
        raise ModelError("pip can't tell its settings; see what 'pip config list' says.") from error
    found = re.findall(r"^(global|download|:env:)\.([\w-]+)=(.+)$", listing, flags=re.MULTILINE)
    return {
        option: ast.literal_eval(value)
        for wanted in ("global", "download", ":env:")
        for section, option, value in found
        if section == wanted
    }


def open_client(settings: PipSettings) -> "PyPIClient":
    """Open an HTTP client with the user's certificates, proxy and stored credentials; it also reads ``file:`` URLs."""
    from unearth.auth import MultiDomainBasicAuth  # noqa: PLC0415
    from unearth.fetchers import PyPIClient  # noqa: PLC0415

    try:
        return PyPIClient(
            trusted_hosts=settings.trusted_hosts,
            verify=ssl.create_default_context(cafile=settings.ca_file) if settings.ca_file else True,
            proxy=settings.proxy,
            timeout=_TIMEOUT_S,
            follow_redirects=True,
            auth=MultiDomainBasicAuth(prompting=False, index_urls=_index_urls(settings)),
        )
    except (OSError, ValueError) as error:
        raise ModelError("pip's setting 'cert' or 'proxy' can't be used; see what 'pip config list' says.") from error


def _index_urls(settings: PipSettings) -> tuple[str, ...]:
    return (*filter(None, [settings.index_url]), *settings.extra_index_urls)


def _find(client: "PyPIClient", settings: PipSettings, pinned: PinnedFile) -> "Link":
    """Find the link of the pinned file at the first index that has it; unreachable indexes are skipped."""
    import httpx2  # noqa: PLC0415

    unreachable = False
    for finder in _finders(client, settings):
        try:
            packages = finder.find_all_packages(pinned.name, allow_yanked=True)
            links = [package.link for package in packages if package.link.filename == pinned.filename]
        except (httpx2.HTTPError, httpx2.InvalidURL, OSError, ValueError):
            unreachable = True
        else:
            if links:
                return links[0]
    if unreachable:
        raise ModelError(
            f"The package index can't be reached, so {pinned} can't be found. Check the network, the proxy and pip's "
            "settings, then try again."
        )
    raise ModelError(
        f"No package index has {pinned} ({pinned.filename}). Check pip's settings index-url, extra-index-url and "
        "find-links."
    )


def _finders(client: "PyPIClient", settings: PipSettings) -> "Iterator[PackageFinder]":
    """Make a finder for each location of packages, local links first."""
    from unearth import PackageFinder  # noqa: PLC0415

    # Files are read, not installed, so that files of other platforms and Python versions are accepted.
    finder = partial(PackageFinder, cast("Fetcher", client), ignore_compatibility=True)
    for link in settings.find_links:
        yield finder(find_links=[link])
    if settings.no_index:
        return
    # Without an index URL the finder searches the default index.
    yield finder(index_urls=filter(None, [settings.index_url]))
    for url in settings.extra_index_urls:
        yield finder(index_urls=[url])
